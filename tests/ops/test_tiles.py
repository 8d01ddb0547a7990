"""Tile lists against a search of every tile for every Gaussian, in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import ALPHA_CUT, TILE_SIZE
from clgs.errors import ClgsError
from clgs.ops import scan, tiles
from clgs.reference import project as reference_project
from clgs.reference import tiles as reference
from clgs.testing.scenes import ProjectedScene, projected_scene
from tests.ops.blend_cases import GEOMETRY, lists_of, render, upload

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


def test_permuted_input_gives_the_same_image(device, rng):
    """N22."""
    scene = projected_scene(rng, 900, 70, 70, 3.0)
    depth = np.float32(10.0) ** rng.uniform(-6, 6, 900).astype(np.float32)
    scene = replace(scene, depth=depth)
    shuffle = rng.permutation(900)
    shuffled = ProjectedScene(**{name: array[shuffle] for name, array in vars(scene).items()})
    images = [render(device, one, (70, 70)).host("image") for one in (scene, shuffled)]
    assert np.array_equal(*images)


@pytest.mark.parametrize("size", [(8192, 8192), (65536, 16)])
def test_tile_numbers_need_more_than_16_bits(device, size):
    """N20: a splat in the last tile."""
    scene = projected_scene(np.random.default_rng(0), 1, 1, 1)
    scene = replace(scene, mean2d=np.float32([[size[0] - 3, size[1] - 3]]))
    lists = on_host(device, lists_of(device, scene, size))
    assert lists["tile_range"][-1] == 1
    assert np.all(lists["tile_range"][:-1] == 0)


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (16, 16), (17, 33)])
@pytest.mark.parametrize("count", [0, 1, 65])
def test_small_images_and_scenes(device, rng, size, count):
    scene = projected_scene(rng, count, *size)
    found = entries(on_host(device, lists_of(device, scene, size)))
    assert touched(scene, size) <= found
    assert len(found - entries(vars(expected_lists(scene, size)))) <= 1


def test_too_many_entries_are_refused_before_allocation(device, rng, monkeypatch):
    """N18; tests of scan hold totals beyond 32 bits."""
    scene = projected_scene(rng, 300, 64, 64, 3.0)
    total = len(lists_of(device, scene, (64, 64)).gaussian)
    monkeypatch.setattr(scan, "MAX_TOTAL", total)
    assert len(lists_of(device, scene, (64, 64)).gaussian) == total
    monkeypatch.setattr(scan, "MAX_TOTAL", total - 1)
    with pytest.raises(ClgsError, match=f"{total} entries"):
        lists_of(device, scene, (64, 64))


def test_other_lengths_are_refused(device, rng):
    scene = projected_scene(rng, 10, 32, 32)
    with pytest.raises(ValueError, match="mean2d"):
        tiles.forward(device, upload(device, scene), device.upload(scene.opacity[:9]), 32, 32)
