"""Accuracy presets of whole renders, and the enlarging of those that are rendered small."""

from dataclasses import replace

import numpy as np
import pytest

from clgs.errors import UsageError
from clgs.lab.scenes import anchor_scene
from clgs.options import PRESETS, RenderOptions, render_options
from clgs.render.renderer import Renderer, enlarge, render_view

LEVEL = 1 / 255


def test_enlarging_keeps_ramps_in_place():
    rows, columns = np.arange(6) + 0.5, np.arange(9) + 0.5
    small = np.stack([rows[:, None] + 0 * columns, columns + 0 * rows[:, None]]).astype(np.float32)
    large = enlarge(np.concatenate([small, small[:1]]), 18, 12)
    inner = (np.arange(1, 11) + 0.5) / 2
    assert large.shape == (3, 12, 18)
    # numbers below 16 with 2 binary places: no rounding anywhere
    assert np.array_equal(large[0, 1:11, 0], inner)
    assert np.array_equal(large[1, 0, 1:17], (np.arange(1, 17) + 0.5) / 2)
    assert np.array_equal(large[0, [0, 11], 5], [0.5, 5.5])  # continued beyond the outer centres
    assert np.array_equal(enlarge(small[[0, 1, 1]], 9, 6), small[[0, 1, 1]])


def test_one_pixel_enlarges_to_a_plain_picture():
    assert np.array_equal(
        enlarge(np.full((3, 1, 1), 0.25, np.float32), 3, 2), np.full((3, 2, 3), 0.25)
    )


@pytest.mark.slow
def test_presets_render_the_same_scene(open_device):
    device = open_device("cpu")
    scene, camera = anchor_scene(3000, 75, 11)
    pictures = {
        name: Renderer(device, scene, render_options(name)).render(camera) for name in PRESETS
    }
    errors = {name: np.abs(pictures[name] - pictures["exact"]) for name in PRESETS}
    assert all(picture.shape == (3, 75, 75) for picture in pictures.values())
    assert 0 < errors["parity"].max() <= 8 * LEVEL
    assert np.abs(pictures["fast"] - pictures["parity"]).max() <= LEVEL
    assert errors["preview"].mean() > errors["fast"].mean()
    half = Renderer(device, scene, render_options("preview")).render(camera.resized(76, 76))
    assert half.shape == (3, 76, 76)


@pytest.mark.slow
def test_preview_is_a_picture_of_half_the_size(device):
    scene, camera = anchor_scene(500, 48, 2)
    # what preview truncates, at full resolution

    options = render_options("preview")
    full = RenderOptions(replace(options.accuracy, downscale=1))
    small = Renderer(device, scene, full).render(camera.reduced(2))
    assert small.shape == (3, 24, 24)
    assert np.array_equal(
        render_view(scene, camera, device, "preview"), enlarge(small, camera.width, camera.height)
    )


def test_unknown_preset_is_refused():
    with pytest.raises(UsageError, match="accuracy: 'best' is not one of exact, parity, fast"):
        render_options("best")


def test_views_that_need_more_room_have_the_same_bits(device):
    scene, camera = anchor_scene(3000, 75, 4)
    near = replace(camera, translation=np.array([0.0, 0.0, 1.5]))
    away = replace(camera, translation=np.array([0.0, 0.0, -9.0]))
    kept = Renderer(device, scene)
    for view in (away, near, camera, near.resized(40, 50), camera.resized(160, 150), away):
        fresh = Renderer(device, scene).render(view)
        assert np.array_equal(kept.render(view), fresh)
        assert (fresh.max() > 0) == (view is not away)
