"""The culling kernels against the float64 reference, on both specialisations."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import BLUR, NEAR_PLANE
from clgs.ops import cull
from clgs.options import RenderOptions, Skips
from clgs.reference import cull as reference
from clgs.scene.camera import Camera
from tests.ops.cases.anchors import on_device
from tests.ops.cases.project import camera_at

EPSILON = 2.0**-24


def anchors(rng, count, spread=3.0):
    position = rng.uniform(-spread, spread, (count, 3)).astype(np.float32)
    scaling = rng.uniform(-6, -1, (count, 6)).astype(np.float32)
    return position, scaling


def run(device, position, scaling, packed, **settings):
    placed = on_device(device, {"position": position, "scaling": scaling})
    return device.download(cull.forward(device, placed, device.upload(packed), **settings).anchor)


def expected(position, scaling, packed):
    return reference.forward(position.astype(np.float64), scaling.astype(np.float64), packed)


def doubtful(position, scaling, packed):
    """Anchors that rounding may decide either way: near a threshold, or near the rounding up."""
    wide = position.astype(np.float64), scaling.astype(np.float64)
    centre, reach, depth = reference.screen_square(*wide, packed)
    # 40 roundings of terms up to |p| f/z + |c| and of the radius; the depth cancels, too
    size = np.abs(centre).max(axis=1) + reach + 1000
    slack = 40 * EPSILON * size * (1 + 8 / np.abs(depth))
    radius = np.ceil(reach)[:, None]
    edges = np.concatenate([centre + radius, centre - radius - reference.tiled_size(packed)], 1)
    near = np.abs(depth - np.float32(NEAR_PLANE)) <= 40 * EPSILON * 8
    rounding = np.abs(reach - np.round(reach)) <= slack
    return near | rounding | (np.abs(edges).min(axis=1) <= slack)


@pytest.mark.parametrize("count", [0, 1, 33, 5000])
def test_agrees_with_reference(device, rng, count):
    position, scaling = anchors(rng, count)
    packed = camera_at().pack(NEAR_PLANE)
    actual = run(device, position, scaling, packed)
    wanted = expected(position, scaling, packed)
    assert actual.dtype == np.int32
    assert np.all(np.diff(actual) > 0)
    differ = np.setxor1d(actual, wanted)
    doubts = doubtful(position, scaling, packed) if count else np.zeros(0, bool)
    assert doubts[differ].all(), differ[~doubts[differ]]
    assert len(differ) <= 1e-3 * count
    if count >= 1000:
        assert 0.2 < len(wanted) / count < 0.8
        assert doubts.mean() < 0.05


def test_all_and_none_visible(device, rng):
    position, scaling = anchors(rng, 70, spread=0.1)
    packed = camera_at().pack(NEAR_PLANE)
    assert np.array_equal(run(device, position, scaling, packed), np.arange(70))
    position[:, 2] -= 100
    assert run(device, position, scaling, packed).shape == (0,)


def test_near_plane_is_exact(device):
    """N07: the depth must exceed the near plane; the value itself is culled."""
    near = np.float32(NEAR_PLANE)
    depths = [-1, 0, 1e-30, np.nextafter(near, 0), near, np.nextafter(near, np.float32(1)), 1]
    position = np.zeros((len(depths), 3), np.float32)
    position[:, 2] = depths
    camera = Camera(np.eye(3), np.zeros(3), 10.0, 10.0, 160.0, 120.0, 320, 240)
    scaling = np.full((len(depths), 6), -3, np.float32)
    assert run(device, position, scaling, camera.pack(NEAR_PLANE)).tolist() == [5, 6]


def test_square_touches_tiles(device):
    """A point of radius 2 (the blur alone) is seen up to 2 pixels outside of whole tiles."""
    camera = Camera(np.eye(3), np.zeros(3), 64.0, 64.0, 16.0, 8.0, 40, 16)
    pixels = np.array([-2.5, -2.0, -1.5, 20.0, 47.5, 49.5, 50.0, 50.5], np.float32)
    position = np.zeros((len(pixels), 3), np.float32)
    position[:, 0], position[:, 2] = (pixels - 16) / 64, 1
    scaling = np.full((len(pixels), 6), -19, np.float32)
    # 40 pixels are 3 tiles = 48 pixels; ceil(3 sqrt(0.3)) = 2
    assert run(device, position, scaling, camera.pack(NEAR_PLANE)).tolist() == [2, 3, 4, 5]


@pytest.mark.parametrize("slot", ["position", "scaling"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, -1e38])
def test_poison_stays_in_its_row(device, rng, slot, poison):
    position, scaling = anchors(rng, 65, spread=0.5)
    packed = camera_at().pack(NEAR_PLANE)
    clean = run(device, position, scaling, packed)
    assert 30 in clean
    (position if slot == "position" else scaling)[30] = poison
    dirty = run(device, position, scaling, packed)
    assert np.array_equal(dirty[dirty != 30], clean[clean != 30])
    if slot == "position" or np.isnan(poison):
        assert 30 not in dirty
    else:
        assert 30 in dirty, "a clamped scale is an ordinary one"


def test_any_room_gives_the_same_anchors(device, rng):
    """Any sufficient one; a smaller one leaves the last out, and the total tells so."""
    position, scaling = anchors(rng, 700)
    packed = camera_at().pack(NEAR_PLANE)
    exact = run(device, position, scaling, packed)
    placed = on_device(device, {"position": position, "scaling": scaling})
    camera = device.upload(packed)
    for room in (0, 1, len(exact) - 1, len(exact), len(exact) + 5, 2000):
        visible = cull.forward(device, placed, camera, room=room)
        assert device.download(visible.total).tolist() == [len(exact)]
        padded = np.concatenate([exact, np.full(2000, -1)])[:room]
        assert np.array_equal(device.download(visible.anchor), padded)


def test_without_the_skip_all_anchors_have_a_place(device, rng):
    position, scaling = anchors(rng, 300)
    packed = camera_at().pack(NEAR_PLANE)
    everything = RenderOptions(skips=Skips(anchors=False))
    found = run(device, position, scaling, packed, options=everything)
    wanted = np.full(300, -1)
    exact = run(device, position, scaling, packed)
    wanted[exact] = exact
    assert np.array_equal(found, wanted)


def test_small_anchors_are_left_out_on_request(device, rng):
    position, scaling = anchors(rng, 3000)
    packed = camera_at().pack(NEAR_PLANE)
    exact = run(device, position, scaling, packed)
    for pixels in (3.0, 10.0, 40.0):
        found = run(
            device, position, scaling, packed, options=RenderOptions(smallest_anchor=pixels)
        )
        reach = reference.screen_square(
            position.astype(np.float64), scaling.astype(np.float64), packed
        )[1]
        # a variance is a difference of terms of up to BLUR more
        width = 6 * np.sqrt((reach / 3) ** 2 - BLUR)[exact]
        slack = 40 * EPSILON * (width + 36 * BLUR / width)
        assert np.setdiff1d(found, exact).size == 0
        assert np.isin(exact[width >= pixels + slack], found).all()
        assert not np.isin(exact[width < pixels - slack], found).any()
        assert 0 < len(found) < len(exact)


def test_wrong_shapes_are_refused(device, rng):
    position, scaling = anchors(rng, 5)
    packed = camera_at().pack(NEAR_PLANE)
    with pytest.raises(ValueError, match="scaling"):
        run(device, position, scaling[:, :3], packed)
    with pytest.raises(ValueError, match="camera"):
        run(device, position, scaling, packed[:25])
