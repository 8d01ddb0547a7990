"""Bad numbers stay where they are: families N01, N02, N03, N04 and N36."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import LOG_SCALE_LIMIT
from clgs.lab.scenes import anchor_scene
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.scene import RenderSettings
from tests.stress.cases import (
    GRADIENTS,
    LEVEL,
    PARTS,
    all_finite,
    changed,
    draw,
    gradients,
    image_gradient,
    part,
    space_scene,
    straight_camera,
)

SLOTS = [("mean", 0), ("mean", 2), ("scale", 1), ("rotation", 3), ("color", 0), ("opacity", 0)]
POISON = [np.nan, np.inf, -np.inf, 3.4e38, -1e38, 1e20, -1e10, 1e-20, -1.2e-38, -1e-45, -0.0]
COUNT, VICTIM = 120, 60
OTHERS = np.arange(COUNT) != VICTIM
CAMERA = straight_camera(32, 32)
D_IMAGE = image_gradient(CAMERA)


@pytest.fixture(scope="module")
def clean():
    return space_scene(np.random.default_rng(1), COUNT, CAMERA, 3.0)


@pytest.fixture(scope="module")
def without(device, clean):
    """Image and gradients of the scene without the splat that gets poisoned."""
    drawn = draw(device, part(clean, OTHERS), CAMERA)
    return drawn.image, gradients(drawn, D_IMAGE)


def index_of(name, column):
    return (VICTIM,) if name == "opacity" else (VICTIM, column)


@pytest.mark.family("N01")
@pytest.mark.parametrize("value", POISON)
@pytest.mark.parametrize("slot", SLOTS, ids=lambda slot: f"{slot[0]}{slot[1]}")
def test_one_bad_number_spoils_one_splat_at_most(device, clean, without, slot, value):
    scene = changed(clean, slot[0], index_of(*slot), value)
    drawn = draw(device, scene, CAMERA)
    assert np.isfinite(drawn.image).all()
    assert np.isfinite(drawn.rendered.host("transmittance")).all()
    found = gradients(drawn, D_IMAGE)
    for name in GRADIENTS:
        assert np.isfinite(found[name][OTHERS]).all(), name
    drawn_at_all = drawn.visible[VICTIM] and not np.isnan(value)
    if not drawn_at_all:
        image, others = without
        assert np.array_equal(drawn.image, image)
        for name in GRADIENTS:
            assert np.array_equal(found[name][OTHERS], others[name]), name
            assert not found[name][VICTIM].any(), name


ANCHOR_SLOTS = [
    *(("position", 0), ("position", 2), ("scaling", 0), ("scaling", 4)),
    *(("feature", 49), ("offset", 1)),
]


@pytest.fixture(scope="module")
def anchors():
    return anchor_scene(160, 32, 5)


def anchor_images(device, scene, camera):
    uploaded = upload_scene(device, scene)
    frame = rasterise(device, uploaded, upload_view(device, camera, RenderSettings()))
    found = rasterise_backward(device, uploaded, frame, device.upload(D_IMAGE), 0.01)
    names = ("d_offset", "d_feature", "d_scaling")
    return device.download(frame.image), {n: device.download(getattr(found, n)) for n in names}


@pytest.mark.family("N01")
@pytest.mark.parametrize("value", POISON[:6])
@pytest.mark.parametrize("slot", ANCHOR_SLOTS, ids=lambda slot: f"{slot[0]}{slot[1]}")
def test_one_bad_parameter_spoils_one_anchor_at_most(device, anchors, slot, value):
    """The same through the whole pipeline, one number of one anchor."""
    scene, camera = anchors
    victim = len(scene.anchors.position) // 2
    array = getattr(scene.anchors, slot[0])
    before = array[victim].copy()
    array[victim, ..., slot[1]] = value
    image, found = anchor_images(device, scene, camera)
    array[victim] = before
    assert np.isfinite(image).all()
    others = np.arange(len(array)) != victim
    for name in found:
        assert np.isfinite(found[name][others]).all(), name


@pytest.mark.family("N02")
@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0])
@pytest.mark.parametrize("slot", ["mean", "scale", "rotation"])
def test_no_opaque_blob(device, slot, bad):
    """A single splat on white: no pixel may hide more than its opacity."""
    scene = part(space_scene(np.random.default_rng(3), 1, CAMERA, 6.0, spread=0.1), [0])
    scene = changed(changed(scene, slot, 0, bad), "opacity", 0, 0.5)
    drawn = draw(device, scene, CAMERA)
    assert 1 - drawn.rendered.host("transmittance").min() <= 0.5
    assert all_finite(drawn, D_IMAGE)


NORMS = [0.0, 1e-45, 1e-30, 1e20]


def with_output(scene, name, rows, change):
    """``scene`` with the biases of one MLP's outputs ``rows`` changed and their weights zero."""
    from clgs.scene.mlps import unpack_head

    layers = unpack_head(scene.mlps.flat, name)
    layers["output_weight"][rows] = 0
    layers["output_bias"][rows] = change


@pytest.mark.family("N03")
@pytest.mark.parametrize("direction", [(1, 2, 3, 4), (0, 0, -1, 0)])
@pytest.mark.parametrize("norm", NORMS)
def test_length_of_a_quaternion_does_not_matter(device, norm, direction):
    """All quaternions of an MLP's outputs get one length; the image stays, or nothing is drawn."""
    images = []
    for length in (1.0, norm):
        scene, camera = anchor_scene(160, 32, 5)
        quaternion = np.float32(np.tile(direction, 10) / np.linalg.norm(direction) * length)
        rows = np.arange(70).reshape(10, 7)[:, 3:].ravel()
        with_output(scene, "covariance", rows, quaternion)
        image, found = anchor_images(device, scene, camera)
        images.append(image)
        assert all(np.isfinite(array).all() for array in found.values())
    if 1e-35 < norm < 1e37:
        assert np.abs(images[0] - images[1]).max() <= 1e-6
        assert images[1].max() > 0.1
    else:
        assert not images[1].any()


@pytest.mark.family("N04")
@pytest.mark.parametrize("column", [0, 2, 3, 5])
@pytest.mark.parametrize("value", [-1e4, -20, 20, 89])
def test_log_scales_of_any_size(device, anchors, value, column):
    scene, camera = anchors
    victim = len(scene.anchors.position) // 2
    before = scene.anchors.scaling[victim, column]
    scene.anchors.scaling[victim, column] = value
    image, found = anchor_images(device, scene, camera)
    scene.anchors.scaling[victim, column] = before
    assert np.isfinite(image).all()
    assert all(np.isfinite(array).all() for array in found.values())
    if abs(value) > LOG_SCALE_LIMIT:
        assert found["d_scaling"][victim, column] == 0


@pytest.mark.family("N04")
@pytest.mark.parametrize("sigma", [1e-12, 1.0, 4.85e8])
def test_any_scale_within_the_limit_is_drawn(device, sigma):
    """4.85e8 = e^20, the largest scale of a Gaussian that the log scales allow."""
    scene = part(space_scene(np.random.default_rng(3), 1, CAMERA), [0])
    scene = changed(changed(scene, "mean", 0, (0.01, 0.02, 0)), "opacity", 0, 0.9)
    drawn = draw(device, changed(scene, "scale", 0, sigma), CAMERA)
    assert drawn.visible.all()
    assert 1 - drawn.rendered.host("transmittance").min() > 0.5
    assert all_finite(drawn, D_IMAGE)


@pytest.mark.family("N36")
@pytest.mark.parametrize("value", [1e3, 1.001e3, 3.4e38, np.inf])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("column", [0, 2])
def test_colours_of_any_size(device, clean, column, sign, value):
    scene = changed(clean, "color", (VICTIM, column), sign * value)
    drawn = draw(device, scene, CAMERA)
    assert all_finite(drawn, D_IMAGE)
    assert np.abs(drawn.image).max() <= 1e3 * (1 + 1e-6)
    d_color = gradients(drawn, D_IMAGE)["d_color"][VICTIM]
    assert (d_color[column] == 0) == (value > 1e3)
    assert (d_color[np.arange(3) != column] != 0).all()


def test_the_cases_draw_something(device, clean, without):
    image, found = without
    assert np.abs(image - image.mean()).max() > 10 * LEVEL
    assert draw(device, clean, CAMERA).visible[VICTIM]
    assert all(found[f"d_{name}"].any() for name in PARTS)
