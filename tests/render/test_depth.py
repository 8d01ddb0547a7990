"""Depth and opacity of whole pictures against float64 with the kernels' decisions."""

from dataclasses import replace

import numpy as np
import pytest

from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import render_reference
from clgs.options import DEFAULT, RenderOptions
from clgs.reference import blend
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise
from clgs.render.renderer import Renderer
from tests.compare import assert_close


def wanted(device, scene, camera):
    """Mean depth and opacity in float64, (H, W) each."""
    frame = rasterise(
        device, upload_scene(device, scene), upload_view(device, camera, scene.settings)
    )
    d_image = device.upload(np.ones(frame.image.shape, np.float32))
    reference = render_reference(device, scene, frame, d_image)
    depth = reference.projected.depth
    color = np.stack([depth, np.ones_like(depth), np.zeros_like(depth)], 1)
    drawn = blend.forward(
        reference.projected, color, reference.gaussians.opacity, reference.lists,
        np.zeros(3), frame.view.size, reference.decisions,
    ).image  # fmt: skip
    weight = np.where(drawn[1] > 0, drawn[1], 1)
    return np.where(drawn[1] > 0, drawn[0] / weight, 0), drawn[1]


@pytest.mark.slow
@pytest.mark.parametrize("max_memory", [None, 1 << 18])
def test_depth_and_opacity_match_float64(device, max_memory):
    scene, camera = anchor_scene(2500, 80, 4)
    background = replace(scene.settings, background=(0.3, 0.9, 0.2))  # must not matter
    lit = replace(scene, settings=background)
    renderer = Renderer(device, lit, RenderOptions(max_memory=max_memory))
    for _ in range(2):  # of the exact size, then in room that is there
        seen = renderer.depth(camera)
        depth, opacity = wanted(device, scene, camera)
        assert (opacity > 0.5).mean() > 0.1
        # products of up to 50 factors 1 - alpha, each of 10 roundings, as those of colors
        assert_close(seen.opacity, opacity, 2e-5, "opacity")
        sure = opacity > 1e-3
        assert_close(seen.depth[sure], depth[sure], 2e-5 * depth.max() / 1e-1, "depth")
        assert np.median(np.abs(seen.depth - depth)[sure]) < 1e-5
        assert not seen.depth[opacity == 0].any()


def test_a_picture_after_a_depth_has_the_bits_of_one_before(device):
    scene, camera = anchor_scene(1500, 64, 2)
    renderer = Renderer(device, scene)
    before = renderer.render(camera).tobytes()
    renderer.depth(camera)
    assert renderer.render(camera).tobytes() == before
    preview = replace(DEFAULT, accuracy=replace(DEFAULT.accuracy, downscale=2))
    assert Renderer(device, scene, preview).depth(camera).depth.shape == (64, 64)


def test_far_scenes_keep_their_depth(device):
    """Blending clamps colors to +-1000; depths are not."""
    scene, camera = anchor_scene(1500, 64, 2)
    times = 1000.0
    position = scene.anchors.position * np.float32(times)
    scaling = scene.anchors.scaling + np.float32(np.log(times))
    far = replace(scene, anchors=replace(scene.anchors, position=position, scaling=scaling))
    seen = Renderer(device, far).depth(replace(camera, translation=camera.translation * times))
    near = Renderer(device, scene).depth(camera)
    sure = (near.opacity > 0.9) & (seen.opacity > 0.9)
    assert sure.any()
    assert np.median(seen.depth[sure] / near.depth[sure]) == pytest.approx(times, rel=1e-2)
