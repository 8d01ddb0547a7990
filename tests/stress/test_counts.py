"""Numbers of things beyond 16, 31 and 32 bits: families N18 and N21; N20 is in test_order.py."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import NEAR_PLANE
from clgs.errors import ClgsError
from clgs.ops import project, scan, tiles
from tests.stress.cases import SHAPE, space_scene, straight_camera

TOTALS = [2**31 - 2, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - 1, 2**32, 2**32 + 1, 2**40 + 7]


def counts_of(total: int, count: int) -> np.ndarray:
    """Counts (n,) int32 that sum up to ``total``; the surplus is in the middle."""
    counts = np.full(count, total // count, np.int32)
    counts[count // 2] += total - int(counts.sum(dtype=np.int64))
    return counts


@pytest.mark.family("N18")
@pytest.mark.parametrize("count", [1000, 4097, 70_000])
@pytest.mark.parametrize("total", TOTALS)
def test_totals_are_exact_in_64_bits(device, total, count):
    """The counting pass alone: no list of that length is made."""
    if total // count >= 2**31 - count:
        pytest.skip("a single count would not fit")
    counts = counts_of(total, count)
    result = scan.on_device(device, device.upload(counts))
    assert int(device.download(result.total)[0]) == total
    # offsets hold the low 32 bits, right up to the first that does not fit
    offset = device.download(result.offset).astype(np.uint32)
    expected = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.uint64)
    assert np.array_equal(offset, (expected & np.uint64(2**32 - 1)).astype(np.uint32))


@pytest.mark.family("N18")
@pytest.mark.parametrize("total", TOTALS)
def test_totals_beyond_31_bits_are_refused(device, total):
    uploaded = device.upload(counts_of(total, 4097))
    if total < 2**31:
        assert scan.exclusive(device, uploaded)[1] == total
        return
    with pytest.raises(ClgsError, match=str(total)):
        scan.exclusive(device, uploaded)


@pytest.mark.family("N21")
@pytest.mark.parametrize(
    "count", [100_000, 1_000_000, pytest.param(3 * 10**7, marks=pytest.mark.slow)]
)
def test_projection_and_counting_of_many_gaussians(device, count):
    """Copies of 1,000 Gaussians: every copy is projected and listed as the first one is."""
    camera = straight_camera(64, 64)
    scene = space_scene(np.random.default_rng(0), 1000, camera, 0.5, spread=2.0)
    copies = count // 1000
    arrays = {
        name: device.upload(np.tile(getattr(scene, name), (copies, *[1] * (n - 1))))
        for name, n in (*((name, 2) for name in SHAPE), ("opacity", 1))
    }
    packed = device.upload(camera.pack(NEAR_PLANE))
    projected = project.forward(device, *arrays.values(), packed)
    mean2d = device.download(projected.mean2d).reshape(copies, 1000, 2)
    assert np.array_equal(mean2d[-1], mean2d[0])
    assert np.array_equal(mean2d[copies // 2], mean2d[0])
    lists = tiles.forward(device, projected, arrays["opacity"], 64, 64)
    rows = np.diff(device.download(lists.row_range).reshape(-1)[: count + 1]).reshape(copies, 1000)
    assert rows[0].sum() > 0
    assert np.array_equal(rows, np.broadcast_to(rows[0], rows.shape))
    assert int(device.download(lists.tile_range)[-1]) == copies * int(rows[0].sum())
