"""Numbers of things beyond 16, 31 and 32 bits: families N18, N19 and N21.

N20 is in test_order.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import NEAR_PLANE
from clgs.errors import ClgsError
from clgs.ops import blend, project, scan, tiles
from clgs.ops.neural import Gaussians
from tests.gaussians import projected_scene
from tests.ops.cases.blend import BACKGROUND, GRADIENTS, render, upload
from tests.stress.cases import SHAPE, space_scene, straight_camera

TOTALS = [2**31 - 1, 2**31, 2**32 + 1, 2**40 + 7]


def counts_of(total: int, count: int) -> np.ndarray:
    """Counts (n,) int32 that sum up to ``total``; the surplus is in the middle."""
    counts = np.full(count, total // count, np.int32)
    counts[count // 2] += total - int(counts.sum(dtype=np.int64))
    return counts


@pytest.mark.family("N18")
@pytest.mark.parametrize("count", [4097, 70_000])
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
@pytest.mark.parametrize("count", [100_000, pytest.param(3 * 10**7, marks=pytest.mark.release)])
def test_projection_and_counting_of_many_gaussians(device, count):
    """Copies of 1,000 Gaussians: every copy is projected and listed as the first one is."""
    camera = straight_camera(64, 64)
    scene = space_scene(np.random.default_rng(0), 1000, camera, 0.5, spread=2.0)
    copies = count // 1000
    arrays = {
        name: device.upload(np.tile(getattr(scene, name), (copies, *[1] * (n - 1))))
        for name, n in (*((name, 2) for name in SHAPE), ("color", 2), ("opacity", 1))
    }
    packed = device.upload(camera.pack(NEAR_PLANE))
    projected = project.forward(device, Gaussians(**arrays), packed)
    mean2d = device.download(projected.mean2d).reshape(copies, 1000, 2)
    assert np.array_equal(mean2d[-1], mean2d[0])
    assert np.array_equal(mean2d[copies // 2], mean2d[0])
    lists = tiles.forward(device, projected, (64, 64))
    rows = np.diff(device.download(lists.row_range).reshape(-1)[: count + 1]).reshape(copies, 1000)
    assert rows[0].sum() > 0
    assert np.array_equal(rows, np.broadcast_to(rows[0], rows.shape))
    assert int(device.download(lists.tile_range)[-1]) == copies * int(rows[0].sum())


def bands_within(entries_of_row: np.ndarray, budget: int) -> list[tuple[int, int]]:
    """Rows of tiles in groups of at most ``budget`` entries; a single row may have more."""
    bands, first = [], 0
    for end in range(1, len(entries_of_row) + 1):
        last = end == len(entries_of_row)
        if last or entries_of_row[first : end + 1].sum() > budget:
            bands.append((first, end))
            first = end
    return bands


def render_in_bands(device, scene, size, bands, d_image):
    """Image and gradients, the lists of one band of tiles at a time."""
    projected, background = upload(device, scene), device.upload(BACKGROUND)
    image = np.empty((3, size[1], size[0]), np.float32)
    sums = device.zeros((len(scene.depth), blend.SUM_SIZE))
    for first, end in bands:
        lists = tiles.forward(device, projected, size, tile_rows=(first, end))
        blended = blend.forward(device, projected, lists, background)
        rows = slice(first * 16, end * 16)
        image[:, rows] = device.download(blended.image)[:, rows]
        masked = np.zeros_like(d_image)
        masked[:, rows] = d_image[:, rows]
        blend.accumulate(device, blended, device.upload(masked), sums)
    found = blend.finish(device, projected, sums)
    return image, {name: device.download(getattr(found, name)) for name in GRADIENTS}


@pytest.mark.family("N19")
@pytest.mark.parametrize("sigma", [1.5, 40.0])
@pytest.mark.parametrize("share", [1.0, 0.4, 0.0])
def test_lists_within_a_budget_change_no_bit(device, share, sigma):
    """``share``: of the whole frame's entries that fit into memory at a time."""
    rng, size = np.random.default_rng(5), (90, 200)
    scene = projected_scene(rng, 600, *size, sigma)
    d_image = rng.normal(size=(3, size[1], size[0])).astype(np.float32)
    whole = render(device, scene, size)
    tile_range = device.download(whole.inputs["tiles"].tile_range)
    entries_of_row = np.diff(tile_range[:: -(-size[0] // 16)])
    bands = bands_within(entries_of_row, int(share * tile_range[-1]))
    assert (len(bands) == 1) == (share == 1.0)
    image, found = render_in_bands(device, scene, size, bands, d_image)
    assert np.array_equal(image, whole.host("image"))
    wanted = whole.backward(d_image)
    for name in GRADIENTS:
        assert np.array_equal(found[name], wanted[name]), name
