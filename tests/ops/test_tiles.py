"""Tile lists against a search of every tile for every Gaussian, in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import ALPHA_CUT, TILE_SIZE
from clgs.errors import ClgsError
from clgs.ops import scan, tiles
from clgs.options import RenderOptions, Skips
from clgs.reference import project as reference_project
from clgs.reference import tiles as reference
from tests.gaussians import ProjectedScene, projected_scene
from tests.ops.cases.blend import GEOMETRY, lists_of, render, upload

FIELDS = ("gaussian", "row", "tile_range", "row_range")


def on_host(device, lists):
    return {name: device.download(getattr(lists, name)) for name in FIELDS}


def expected_lists(scene, size):
    wide = {name: getattr(scene, name).astype(np.float64) for name in GEOMETRY}
    projected = reference_project.Projected(**wide)
    return reference.forward(projected, scene.opacity.astype(np.float64), *size)


def entries(lists):
    """{(tile, Gaussian)}."""
    tile = np.repeat(np.arange(len(lists["tile_range"]) - 1), np.diff(lists["tile_range"]))
    return set(zip(tile.tolist(), lists["gaussian"].tolist(), strict=True))


def touched(scene, size):
    """{(tile, Gaussian)} with alpha >= ALPHA_CUT at some pixel centre."""
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    tile = y // TILE_SIZE * -(-size[0] // TILE_SIZE) + x // TILE_SIZE
    found = set()
    for i in range(len(scene.depth)):
        dx, dy = x + 0.5 - scene.mean2d[i, 0], y + 0.5 - scene.mean2d[i, 1]
        r1, l_factor, r2 = scene.whitening[i].astype(np.float64)
        power = 0.5 * ((dx * r1) ** 2 + ((dy - l_factor * dx) * r2) ** 2)
        # a little more than the cut: the kernels may round the other way at the cut itself
        hit = scene.opacity[i] * np.exp(-power) >= ALPHA_CUT * (1 + 1e-5)
        found |= {(t, i) for t in np.unique(tile[hit]).tolist()}
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "ratio"), [(1.1, 3.0), (5.0, 3.0), (30.0, 100.0)])
def test_lists_hold_what_the_reference_finds(device, rng, sigma, ratio):
    scene = projected_scene(rng, 800, 150, 90, sigma, ratio)
    actual = on_host(device, lists_of(device, scene, (150, 90)))
    expected = entries(vars(expected_lists(scene, (150, 90))))
    found = entries(actual)
    assert touched(scene, (150, 90)) <= found
    # the slack for rounding lists a tile more where an ellipse almost touches it
    assert len(found - expected) <= max(2, 1e-3 * len(expected))


def test_order_within_the_lists(device, rng):
    scene = projected_scene(rng, 700, 100, 100, 6.0)
    depth = np.round(scene.depth, 1)  # many ties
    scene = replace(scene, depth=depth, extent=np.where(depth[:, None] > 9, 0, scene.extent))
    lists = on_host(device, lists_of(device, scene, (100, 100)))
    assert set(lists["gaussian"]) <= set(np.flatnonzero(scene.extent[:, 0] > 0))
    for first, end in zip(lists["tile_range"], lists["tile_range"][1:], strict=False):
        members = lists["gaussian"][first:end]
        assert np.array_equal(members, members[np.lexsort((members, depth[members]))])


def test_rows_of_a_gaussian_are_contiguous(device, rng):
    scene = projected_scene(rng, 300, 100, 60, 8.0)
    lists = on_host(device, lists_of(device, scene, (100, 60)))
    assert sorted(lists["row"]) == list(range(len(lists["row"])))
    owner = np.empty(len(lists["row"]), np.int64)
    owner[lists["row"]] = lists["gaussian"]
    assert np.array_equal(owner, np.repeat(np.arange(300), np.diff(lists["row_range"])))


@pytest.mark.parametrize("size", [(1, 1), (40, 1), (17, 33)])
@pytest.mark.parametrize("count", [0, 65])
def test_small_images_and_scenes(device, rng, size, count):
    scene = projected_scene(rng, count, *size)
    found = entries(on_host(device, lists_of(device, scene, size)))
    assert touched(scene, size) <= found
    assert len(found - entries(vars(expected_lists(scene, size)))) <= 1


@pytest.mark.slow
def test_large_gaussians_keep_their_order(device, rng):
    """Boxes of more tiles than fit a set of them, and small ones."""
    scene = projected_scene(rng, 400, 1300, 100, 3.0)
    wide = projected_scene(rng, 400, 1300, 100, 250.0, 40.0)
    mixed = ProjectedScene(
        **{
            name: np.where(np.arange(400).reshape(-1, *[1] * (one.ndim - 1)) % 3, one, other)
            for (name, one), other in zip(vars(scene).items(), vars(wide).values(), strict=True)
        }
    )
    lists = on_host(device, lists_of(device, mixed, (1300, 100)))
    expected = expected_lists(mixed, (1300, 100))
    found, wanted = entries(lists), entries(vars(expected))
    assert touched(mixed, (1300, 100)) <= found
    assert len(found - wanted) <= 1e-3 * len(wanted)
    sizes = np.diff(lists["row_range"])
    assert sizes.max() > 200
    assert np.count_nonzero((sizes > 0) & (sizes <= 4)) > 50
    tile = np.repeat(np.arange(len(lists["tile_range"]) - 1), np.diff(lists["tile_range"]))
    by_row = np.empty(len(tile), np.int64)
    by_row[lists["row"]] = tile
    for first, end in zip(lists["row_range"], lists["row_range"][1:], strict=False):
        assert np.all(np.diff(by_row[first:end]) > 0), "rows of a Gaussian go by tile"


def in_room(device, scene, size, room, tile_rows=None):
    return tiles.forward(device, upload(device, scene), size, room=room, tile_rows=tile_rows)


@pytest.mark.parametrize("sigma", [1.1, 90.0])
def test_any_room_gives_the_same_lists(device, rng, sigma):
    """Any sufficient one; padding lies after the last tile's entries, in rows of its own."""
    size = (150, 90)
    scene = projected_scene(rng, 500, *size, sigma)
    exact = on_host(device, lists_of(device, scene, size))
    total = len(exact["row"])
    for spare in (0, 1, 1000):
        lists = in_room(device, scene, size, total + spare)
        assert device.download(lists.total).tolist() == [total]
        found = on_host(device, lists)
        for name in ("tile_range", "row_range"):
            assert np.array_equal(found[name], exact[name])
        for name in ("row", "gaussian"):
            assert len(found[name]) == total + spare
            assert np.array_equal(found[name][:total], exact[name])
        assert sorted(found["row"]) == list(range(total + spare))
        assert np.all(found["gaussian"][total:] == 0)


@pytest.mark.parametrize("sigma", [1.1, 90.0])
def test_too_small_a_room_tells_the_total(device, rng, sigma):
    """The lists are empty then, and nothing is written out of bounds (race_check.sh)."""
    size = (150, 90)
    scene = projected_scene(rng, 500, *size, sigma)
    total = len(lists_of(device, scene, size).row)
    for room in (0, 1, total - 1):
        lists = in_room(device, scene, size, room)
        assert device.download(lists.total).tolist() == [total]
        found = on_host(device, lists)
        assert not found["tile_range"].any()
        assert not found["row_range"].any()
        assert sorted(found["row"]) == list(range(room))


def test_lists_of_some_rows_of_tiles(device, rng):
    """They are those of the whole picture; the other tiles are empty."""
    size = (150, 200)
    scene = projected_scene(rng, 500, *size, 30.0)
    whole = on_host(device, lists_of(device, scene, size))
    for first, end in ((0, 3), (3, 4), (4, 13), (13, 13)):
        band = on_host(device, in_room(device, scene, size, scan.EXACT, (first, end)))
        cuts = whole["tile_range"][[first * 10, end * 10]]
        assert np.array_equal(band["gaussian"], whole["gaussian"][slice(*cuts)])
        starts = np.clip(whole["tile_range"], *cuts) - cuts[0]
        assert np.array_equal(band["tile_range"], starts)
        owner = np.empty(len(band["row"]), np.int64)
        owner[band["row"]] = band["gaussian"]
        assert np.array_equal(owner, np.repeat(np.arange(500), np.diff(band["row_range"])))


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "ratio"), [(1.1, 30.0), (40.0, 4e3), (4e4, 4e5)])
def test_exact_tiles_change_no_bit(device, rng, sigma, ratio):
    """Every tile of the bounding box instead: longer lists, the same image and gradients."""
    size = (100, 70)
    scene = projected_scene(rng, 1500, *size, sigma, ratio)
    boxes = RenderOptions(skips=Skips(exact_tiles=False))
    longer = tiles.forward(device, upload(device, scene), size, boxes)
    one, other = render(device, scene, size), render(device, scene, size, longer)
    assert len(longer.row) > 1.04 * len(one.inputs["tiles"].row)
    for name in ("image", "transmittance"):
        assert np.array_equal(one.host(name), other.host(name))
    d_image = rng.normal(size=(3, 70, 100)).astype(np.float32)
    found, wanted = one.backward(d_image), other.backward(d_image)
    for name, gradient in found.items():
        assert np.array_equal(gradient, wanted[name]), name


def test_too_many_entries_are_refused_before_allocation(device, rng, monkeypatch):
    """N18; tests of scan hold totals beyond 32 bits."""
    scene = projected_scene(rng, 300, 64, 64, 3.0)
    total = len(lists_of(device, scene, (64, 64)).gaussian)
    monkeypatch.setattr(scan, "MAX_TOTAL", total)
    assert len(lists_of(device, scene, (64, 64)).gaussian) == total
    monkeypatch.setattr(scan, "MAX_TOTAL", total - 1)
    with pytest.raises(ClgsError, match=f"{total} entries"):
        lists_of(device, scene, (64, 64))


def test_more_entries_than_32_bits_hold_are_counted(device):
    """A part of the Gaussians alone has more: 300 that cover 60,000 x 60,000 pixels."""
    count, size = 300, (60_000, 60_000)
    scene = projected_scene(np.random.default_rng(0), count, *size)
    scene = replace(
        scene,
        mean2d=np.full((count, 2), 30_000, np.float32),
        whitening=np.float32([[1e-6, 0, 1e-6]]).repeat(count, 0),
        opacity=np.full(count, 0.9, np.float32),
        extent=np.full((count, 2), 30_001, np.float32),
    )
    with pytest.raises(ClgsError, match=f"{count * (60_000 // TILE_SIZE) ** 2} entries"):
        lists_of(device, scene, size)


def test_other_lengths_are_refused(device, rng):
    scene = projected_scene(rng, 10, 32, 32)
    scene = replace(scene, opacity=scene.opacity[:9])
    with pytest.raises(ValueError, match="mean2d"):
        tiles.forward(device, upload(device, scene), (32, 32))
