"""Which splats a pixel meets, and in which order: families N08, N11, N12, N20, N22, N23 and N26."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from clgs.constants import ALPHA_CUT, TILE_SIZE
from clgs.ops import tiles
from clgs.options import RenderOptions, Skips
from tests.gaussians import ProjectedScene, projected_scene
from tests.ops.cases.blend import GRADIENTS, every_tile_lists, lists_of, render
from tests.stress.cases import (
    LEVEL,
    assert_matches,
    changed,
    draw,
    image_gradient,
    part,
    space_scene,
    straight_camera,
)

CUT = np.float32(ALPHA_CUT)
ALL = RenderOptions(skips=Skips(**{skip.name: False for skip in fields(Skips)}))
SIDES = [1, 2, 7, 8, 9, 15, 16, 17, 31, 33]
"""Every width is paired with another height, below."""


def same_bits(first, second, d_image):
    """Image, transmittance and gradients of two renders of the same Gaussians."""
    for name in ("image", "transmittance"):
        assert np.array_equal(first.host(name), second.host(name)), name
    one, other = first.backward(d_image), second.backward(d_image)
    for name in GRADIENTS:
        assert np.array_equal(one[name], other[name]), name


@pytest.mark.slow
@pytest.mark.family("N12")
@pytest.mark.parametrize(
    ("sigma", "ratio"), [(0.3, 1.0), (1.0, 5.0), (4.0, 300.0), (20.0, 5.0), (500.0, 300.0)]
)
@pytest.mark.parametrize("size", [(40, 40), (75, 50)])
def test_culled_equals_brute_force(device, size, sigma, ratio):
    """Every Gaussian in every tile, and at every pixel, gives the same bits."""
    rng = np.random.default_rng(int(10 * sigma + ratio))
    scene = projected_scene(rng, 200, *size, sigma, ratio)
    d_image = rng.normal(size=(3, size[1], size[0])).astype(np.float32)
    full = every_tile_lists(device, scene, size)
    same_bits(render(device, scene, size), render(device, scene, size, full, options=ALL), d_image)


OPACITIES = {
    "zero": 0.0,
    "negative": -0.5,
    "tiny": 1e-8,
    "below the cut": np.nextafter(CUT, np.float32(0)),
    "at the cut": CUT,
    "above the cut": np.nextafter(CUT, np.float32(1)),
    "half": 0.5,
    "saturated": 0.99,
    "one": 1.0,
    "above one": np.nextafter(np.float32(1), np.float32(2)),
    "two": 2.0,
}


@pytest.mark.family("N11")
@pytest.mark.parametrize("opacity", OPACITIES.values(), ids=OPACITIES)
@pytest.mark.parametrize("sigma", [0.4, 30.0])
def test_any_opacity_makes_tight_lists(device, sigma, opacity):
    rng = np.random.default_rng(1)
    scene = projected_scene(rng, 100, 40, 40, sigma)
    scene.opacity[::2] = opacity
    # a box for all, so that the tiles' own test decides
    scene = replace(scene, extent=np.full((100, 2), 50, np.float32))
    d_image = rng.normal(size=(3, 40, 40)).astype(np.float32)
    tight = render(device, scene, (40, 40))
    full = render(device, scene, (40, 40), every_tile_lists(device, scene, (40, 40)))
    same_bits(tight, full, d_image)
    assert np.isfinite(tight.host("image")).all()
    assert all(np.isfinite(array).all() for array in tight.backward(d_image).values())
    if opacity < CUT:
        scene.extent[::2] = 0
        assert np.array_equal(tight.host("image"), render(device, scene, (40, 40)).host("image"))


@pytest.mark.family("N11")
@pytest.mark.parametrize("opacity", OPACITIES.values(), ids=OPACITIES)
def test_any_opacity_is_projected(device, opacity):
    camera = straight_camera(32, 32)
    scene = space_scene(np.random.default_rng(3), 60, camera)
    scene = changed(scene, "mean", slice(None, None, 3), (0.1, 0, 0))
    drawn = draw(device, changed(scene, "opacity", slice(None, None, 3), opacity), camera)
    # at the cut itself, alpha reaches it in a single point
    assert np.all(drawn.visible[::3] == (opacity > CUT))
    d_image = image_gradient(camera)
    if 0 < opacity <= 1:
        assert_matches(drawn, d_image)


DEPTHS = {
    "equal": lambda rng, n: np.full(n, 3.0),
    "few": lambda rng, n: rng.integers(1, 4, n).astype(float),
    "ulps": lambda rng, n: 1 + rng.integers(0, 5, n) * 2.0**-23,
    "decades": lambda rng, n: 10.0 ** rng.uniform(-6, 6, n),
    "denormal": lambda rng, n: np.where(rng.random(n) < 0.5, 1e-45, 1e-40 * rng.random(n)),
    "outlier": lambda rng, n: np.where(np.arange(n) == 7, 1e30, 1 + 1e-4 * rng.random(n)),
    "reversed": lambda rng, n: np.arange(n, 0, -1.0),
    "powers": lambda rng, n: 2.0 ** rng.integers(-126, 127, n),
}


def with_depths(kind: str, seed: int, size: tuple[int, int]) -> ProjectedScene:
    rng = np.random.default_rng(seed)
    scene = projected_scene(rng, 300, *size, 4.0)
    return replace(scene, depth=DEPTHS[kind](rng, 300).astype(np.float32))


@pytest.mark.family("N22")
@pytest.mark.parametrize("kind", DEPTHS)
def test_lists_are_in_stable_depth_order(device, kind):
    scene = with_depths(kind, 0, (50, 50))
    lists = lists_of(device, scene, (50, 50))
    gaussian, tile_range = (device.download(x) for x in (lists.gaussian, lists.tile_range))
    rank = np.empty(300, int)
    rank[np.argsort(scene.depth, kind="stable")] = np.arange(300)
    for first, end in pairwise(tile_range):
        assert np.all(np.diff(rank[gaussian[first:end]]) > 0)


@pytest.mark.family("N22")
@pytest.mark.parametrize("kind", ["decades", "reversed"])
def test_permuted_input_is_the_same_picture(device, kind):
    scene = with_depths(kind, 0, (50, 50))
    shuffle = np.random.default_rng(0).permutation(300)
    shuffled = ProjectedScene(**{name: array[shuffle] for name, array in vars(scene).items()})
    d_image = np.random.default_rng(9).normal(size=(3, 50, 50)).astype(np.float32)
    one, other = render(device, scene, (50, 50)), render(device, shuffled, (50, 50))
    assert np.array_equal(one.host("image"), other.host("image"))
    first, second = one.backward(d_image), other.backward(d_image)
    for name in GRADIENTS:
        assert np.array_equal(first[name][shuffle], second[name]), name


@pytest.mark.family("N23")
def test_order_follows_the_centres(device):
    """A documented limit, as in the paper: the picture jumps when two centres swap."""
    camera = straight_camera(32, 32)
    scene = space_scene(np.random.default_rng(0), 2, camera, 8.0)
    scene = changed(scene, "mean", slice(None), (0, 0, 0))
    scene = changed(changed(scene, "opacity", slice(None), 0.8), "color", 0, (1, 0, 0))
    scene = changed(scene, "color", 1, (0, 1, 0))
    images = [
        draw(device, changed(scene, "mean", (0, 2), step), camera).image for step in (-1e-6, 1e-6)
    ]
    assert np.abs(images[0] - images[1]).max() > 100 * LEVEL


@pytest.mark.family("N26")
@pytest.mark.parametrize(
    ("width", "height"), list(zip(SIDES, [*SIDES[3:], *SIDES[:3]], strict=True))
)
def test_every_remainder_of_the_tile(device, width, height):
    camera = straight_camera(width, height, 24.0)
    scene = space_scene(np.random.default_rng(width * 64 + height), 40, camera, 3.0)
    assert_matches(draw(device, scene, camera), image_gradient(camera), gradient=2e-5)


@pytest.mark.family("N26")
@pytest.mark.parametrize("size", [(257, 257), (4096, 1), (1, 4096), (33, 47)])
def test_odd_images(device, size):
    camera = straight_camera(*size, 300.0)
    scene = space_scene(np.random.default_rng(5), 250, camera, 3.0, spread=0.55)
    # pixel coordinates of thousands have fewer digits left for offsets
    coarse = max(1, max(size) / 512)
    d_image = image_gradient(camera)
    assert_matches(draw(device, scene, camera), d_image, 5e-3 * coarse, 1e-5 * coarse)


@pytest.mark.family("N26")
@pytest.mark.parametrize("size", [(1, 1), (17, 5), (16, 16), (41, 23)])
def test_a_larger_image_holds_the_smaller(device, size):
    scene = projected_scene(np.random.default_rng(2), 300, 41, 23, 3.0)
    small, large = (render(device, scene, one).host("image") for one in (size, (80, 64)))
    assert np.array_equal(small, large[:, : size[1], : size[0]])


@pytest.mark.family("N08")
@pytest.mark.parametrize(
    ("corner", "sigma"), [((0, 0), 3.0), ((5, 9), 0.5), ((16, 32), 12.0), ((31, 17), 3.0)]
)
def test_off_centre_crop_equals_the_frame(device, corner, sigma):
    """The slope limits follow the principal point: both frames see the same splats as free."""
    frame = straight_camera(96, 80, 110.0)
    crop = replace(frame, cx=frame.cx - corner[0], cy=frame.cy - corner[1], width=48, height=40)
    scene = space_scene(np.random.default_rng(int(10 * sigma)), 900, frame, sigma)
    # centres within the margin of the crop, a fraction of its own size
    centre = 110 * scene.mean[:, :2] / (scene.mean[:, 2:] + 4) + (crop.cx, crop.cy)
    margin = 0.14 * np.array([48, 40])
    near = np.all((centre > -margin) & (centre - margin < (48, 40)), axis=1)
    whole, cut = (draw(device, part(scene, near), camera).image for camera in (frame, crop))
    expected = whole[:, corner[1] : corner[1] + 40, corner[0] : corner[0] + 48]
    error = np.abs(cut - expected) / LEVEL
    # a pair at the alpha cut may flip, as offsets round differently: at most one level there
    assert np.mean(error > 2e-3) <= 1e-3
    assert error.max() <= 1.05


@pytest.mark.family("N20")
@pytest.mark.parametrize("size", [(65536, 16), (8192, 8192)])
def test_last_tile_of_a_large_image(device, size):
    """A splat in the last corner is listed in the last tile alone."""
    scene = projected_scene(np.random.default_rng(0), 1, 1, 1)
    scene = replace(scene, mean2d=np.float32([[size[0] - 3, size[1] - 3]]))
    tile_range = device.download(lists_of(device, scene, size).tile_range)
    assert len(tile_range) == tiles.tile_count(*size) + 1
    assert tile_range[-1] == 1
    assert not tile_range[:-1].any()


@pytest.mark.release
@pytest.mark.family("N20")
@pytest.mark.parametrize("size", [(65536, 16), (8192, 8192)])
def test_last_tile_is_blended(device, size):
    rng = np.random.default_rng(0)
    scene = projected_scene(rng, 40, TILE_SIZE, TILE_SIZE, 2.0)
    moved = replace(scene, mean2d=scene.mean2d + np.float32(size) - np.float32(TILE_SIZE))
    corner = render(device, moved, size).host("image")[:, -TILE_SIZE:, -TILE_SIZE:]
    error = np.abs(corner - render(device, scene, (TILE_SIZE, TILE_SIZE)).host("image"))
    # centres 8,192 pixels away are rounded to 2^-11 pixels
    assert error.max() <= 2 * LEVEL * size[0] / 8192
