"""Memory budgets: groups of rows of tiles give the bits of one long list (N18, N19)."""

from dataclasses import replace

import numpy as np
import pytest

from clgs.errors import ClgsError, DeviceError
from clgs.lab.scenes import anchor_scene
from clgs.ops import scan, tiles
from clgs.options import DEFAULT, RenderOptions
from clgs.render import tile_groups
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.scene import RenderSettings

MIB = 2**20


def run(device, max_memory, gaussians=4000, size=150):
    """The frame, and everything that a step takes from it."""
    scene, camera = anchor_scene(gaussians, size, 5)
    camera = replace(camera, height=size - 23)  # a last row of tiles that is cut
    uploaded = upload_scene(device, scene)
    options = replace(DEFAULT, max_memory=max_memory)
    view = upload_view(device, camera, RenderSettings((0.1, 0.2, 0.3)))
    frame = rasterise(device, uploaded, view, options)
    d_image = np.random.default_rng(1).normal(size=frame.image.shape).astype(np.float32)
    gradients = rasterise_backward(device, uploaded, frame, device.upload(d_image), 0.01)
    names = ("image", "transmittance", "last_contributor")
    found = {name: device.download(getattr(frame.blended, name)) for name in names}
    arrays = {**vars(gradients), **vars(gradients.d_projected)}
    del arrays["d_projected"]
    found |= {name: device.download(array) for name, array in arrays.items()}
    return frame, found


def test_budgets_change_no_bit(device):
    """Image, transmittance and all gradients; the smallest budget is one row of tiles at a time."""
    frame, whole = run(device, None)
    assert frame.groups is None
    by_row = tiles.count_by_row(device, frame.projected, frame.view.size)
    entry = tile_groups.LIST_BYTES[device.specialisation] + tile_groups.BYTES_BY_ENTRY
    assert int(by_row.sum()) == len(frame.tiles.gaussian)
    numbers = []
    for budget in (256 * MIB, entry * int(by_row.sum()) // 3, entry * int(by_row.max())):
        grouped, found = run(device, budget)
        numbers.append(len(grouped.groups.rows) if grouped.groups else 1)
        assert device.download(grouped.tiles.total).tolist() == [int(by_row.sum())]
        for name, array in whole.items():
            assert np.abs(array).max() > 0, name
            assert np.array_equal(array, found[name]), (budget, name)
    assert numbers[0] == 1
    assert 3 <= numbers[1] < numbers[2] <= len(by_row)


@pytest.mark.slow
def test_budgets_change_no_bit_at_full_size(device):
    """200,000 Gaussians at 400 x 400: no budget, 256 MiB and 16 MiB."""
    _, whole = run(device, None, 200_000, 400)
    for budget in (256 * MIB, 16 * MIB):
        frame, found = run(device, budget, 200_000, 400)
        assert (frame.groups is not None) == (budget == 16 * MIB)
        for name, array in whole.items():
            assert np.array_equal(array, found[name]), (budget, name)


def test_too_small_a_budget_is_named(device):
    with pytest.raises(ClgsError, match=r"a row of tiles needs .* MiB.*--max-memory"):
        run(device, 1000)


def test_counts_by_row_are_those_of_the_lists(device):
    frame, _ = run(device, None)
    lists = frame.tiles
    starts = device.download(lists.tile_range)[:: tiles.tile_count(frame.view.size[0], 1)]
    by_row = tiles.count_by_row(device, frame.projected, frame.view.size)
    assert np.array_equal(by_row, np.diff(starts))


@pytest.mark.parametrize("total", [2**31 - 1, 2**31, 2**32 + 1])
def test_plans_beyond_31_bits(total):
    """A group is never longer than an index reaches; together they hold every row."""
    by_row = np.full(100, total // 100, np.int64)
    by_row[3] += total - int(by_row.sum())
    for budget in (136 * 2**40, 6 * 2**30, 136 * int(by_row.max())):
        groups = tile_groups.split(by_row, 136, budget)
        assert [first for first, _ in groups.rows[1:]] == [end for _, end in groups.rows[:-1]]
        assert (groups.rows[0][0], groups.rows[-1][1]) == (0, 100)
        sums = [int(by_row[first:end].sum()) for first, end in groups.rows]
        assert max(sums) == groups.longest <= min(scan.MAX_TOTAL, budget // 136)
        for one, other in zip(sums, by_row[[end for _, end in groups.rows[:-1]]], strict=False):
            assert one + other > min(scan.MAX_TOTAL, budget // 136), "a group could be longer"
    assert (len(tile_groups.split(by_row, 136, 136 * 2**40).rows) > 1) == (total > scan.MAX_TOTAL)


def test_a_row_beyond_31_bits_is_refused():
    with pytest.raises(ClgsError, match=r"needs 417792\.01 MiB"):
        tile_groups.split(np.array([5, 2**32 + 1 - 2**30]), 136, 2**60)


def test_no_rows_are_one_empty_group():
    assert tile_groups.split(np.zeros(0, np.int64), 136, 2**20).rows == ((0, 0),)


def test_impossible_allocations_are_named(device):
    """T06: one line, no abort."""
    with pytest.raises(DeviceError, match=r"no room for an array of \d+ MiB.*--max-memory"):
        device.empty((2**50,))
    assert RenderOptions().max_memory is None
