"""Pictures of ordinary Gaussians and their gradients against float64 (tier 1)."""

import numpy as np
import pytest

from clgs.constants import NEAR_PLANE
from clgs.lab.kernels import blend_decisions
from clgs.options import RenderOptions
from clgs.reference import blend, neural, project, tiles
from clgs.reference.general import splats
from clgs.render.frame import upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.render.renderer import Renderer
from clgs.scene.scene import RenderSettings, SplatScene
from clgs.train.quality.scores import to_8bit
from tests.compare import relative_l2
from tests.ops.cases.project import camera_at
from tests.ops.cases.splats import stored, widen

LEVEL = 1 / 255
CAMERA = camera_at(60.0, 72, 56)
SETTINGS = RenderSettings(background=(0.2, 0.5, 0.8))


def rendered(device, gaussians):
    uploaded = gaussians.map(device.upload)
    return uploaded, rasterise(device, uploaded, upload_view(device, CAMERA, SETTINGS))


def reference(device, gaussians, frame, d_image):
    """Image and gradients in float64, with the kernels' lists and decisions."""
    packed = CAMERA.pack(NEAR_PLANE).astype(np.float64)
    seen = splats.forward(widen(gaussians), packed)
    shape = seen.mean, seen.scale, seen.rotation
    projected = project.forward(*shape, seen.opacity, packed)
    names = "gaussian", "row", "tile_range", "row_range"
    found = {name: device.download(getattr(frame.blended.tiles, name)) for name in names}
    lists = tiles.TileLists(**found)
    decisions, _ = blend_decisions(device, frame.blended, device.upload(d_image))
    light = seen.color, seen.opacity, lists, np.array(SETTINGS.background)
    image = blend.forward(projected, *light, (72, 56), decisions).image
    drawn = blend.backward(projected, *light, decisions, d_image.astype(np.float64))
    d_shape = project.backward(shape, packed, projected, drawn.d_mean2d, drawn.d_whitening)
    d_seen = neural.Gaussians(*d_shape, drawn.d_color, drawn.d_opacity)
    return image, splats.backward(widen(gaussians), packed, d_seen)


@pytest.mark.parametrize("degree", [0, 3])
def test_image_and_gradients_match_float64(device, rng, degree):
    gaussians = stored(rng, 400, degree)
    gaussians.sh[:, 0] += 2  # no color is near 0, where its gradient has a step
    uploaded, frame = rendered(device, gaussians)
    d_image = rng.normal(size=(3, 56, 72)).astype(np.float32)
    found = rasterise_backward(device, uploaded, frame, device.upload(d_image))
    image, wanted = reference(device, gaussians, frame, d_image)
    error = np.abs(device.download(frame.image) - image)
    assert np.quantile(error, 0.999) <= 1e-3 * LEVEL * max(1, np.abs(image).max())
    assert error.max() <= 5e-3 * LEVEL * max(1, np.abs(image).max())
    for name, array in found.d_stored.items():
        expected = getattr(wanted, name)
        assert np.abs(expected).max() > 0, name
        assert relative_l2(device.download(array), expected) <= 1e-5, name


def test_a_wall_with_a_coefficient_of_minus_one_shows_56(device, rng):
    """The color is in sRGB: 255 (1/2 - 0.2821) = 55.6, without a display transform.

    Alphas of at most 0.88 leave less than 0.001 of the background where blending stops.
    """
    count = 40
    wall = stored(rng, count, 0)
    wall.mean[:] = rng.uniform(-0.1, 0.1, (count, 3))
    wall.log_scale[:], wall.opacity[:], wall.sh[:] = 1.0, 2.0, -1.0
    picture = to_8bit(Renderer(device, SplatScene(wall)).render(CAMERA))
    assert (picture[14:42, 18:54] == 56).all()


@pytest.mark.parametrize("max_memory", [None, 1 << 18])
def test_all_ways_to_draw_give_the_same_bits(device, rng, max_memory):
    gaussians = stored(rng, 2000)
    uploaded, frame = rendered(device, gaussians)
    image = device.download(frame.image)
    options = RenderOptions(max_memory=max_memory)
    picture = rasterise(device, uploaded, frame.view, options)
    assert np.array_equal(device.download(picture.image), image)
    renderer = Renderer(device, SplatScene(gaussians, SETTINGS), options)
    renderer.check_budget([("one", CAMERA)])
    for _ in range(2):
        assert np.array_equal(renderer.render(CAMERA), image)
    assert renderer.depth(CAMERA).depth.max() > 1
