"""Whole renders and their gradients against float64 with the kernels' decisions (tier 1)."""

from dataclasses import replace

import numpy as np
import pytest

from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import backward_reference, render_reference
from clgs.ops import loss
from clgs.ops.scan import EXACT
from clgs.options import DEFAULT, RenderOptions, Skips
from clgs.reference import loss as loss_reference
from clgs.render.frame import EXACT_ROOM, Room, upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.scene import RenderSettings
from tests.compare import relative_l2
from tests.ops.cases.splats import stored

LEVEL = 1 / 255
VOLUME_WEIGHT = 0.01


def rendered(device, gaussians, size, seed, background):
    scene, camera = anchor_scene(gaussians, size, seed)
    uploaded = upload_scene(device, scene)
    settings = RenderSettings(background=background)
    frame = rasterise(device, uploaded, upload_view(device, camera, settings))
    photo = np.random.default_rng(seed).integers(0, 256, (3, size, size)).astype(np.uint8)
    return scene, uploaded, frame, photo


@pytest.mark.parametrize(
    ("gaussians", "size", "background"),
    [(3000, 96, (0, 0, 0)), (800, 65, (1, 1, 1)), (6000, 48, (0.2, 0.5, 0.8))],
)
def test_image_and_gradients_match_float64(device, gaussians, size, background):
    scene, uploaded, frame, photo = rendered(device, gaussians, size, 7, background)
    target = device.upload(photo)
    compared = loss.forward(device, frame.image, target)
    d_image = loss.backward(device, frame.image, target, compared)
    gradients = rasterise_backward(device, uploaded, frame, d_image, VOLUME_WEIGHT)
    reference = render_reference(device, scene, frame, d_image)
    image = device.download(frame.image).astype(np.float64)

    error = np.abs(image - reference.image)
    assert np.quantile(error, 0.999) <= 1e-3 * LEVEL
    assert error.max() <= 5e-3 * LEVEL

    wanted_d_image = loss_reference.backward(reference.image, photo)
    assert relative_l2(device.download(d_image), wanted_d_image) <= 1e-5
    # from here on the kernels' own d_image: |x| has a kink where render and photo agree
    wanted = backward_reference(
        reference, device.download(d_image).astype(np.float64), VOLUME_WEIGHT
    )
    for name, expected in wanted.items():
        actual = device.download(getattr(gradients, name))
        assert np.abs(expected).max() > 0, name
        assert relative_l2(actual, expected) <= 1e-5, name


def test_decoding_every_anchor_changes_no_bit(device):
    """Anchors outside of the frustum draw nothing."""
    scene, camera = anchor_scene(2000, 64, 5)
    close = replace(camera, fx=4 * camera.fx, fy=4 * camera.fy)
    uploaded = upload_scene(device, scene)
    options = RenderOptions(skips=Skips(anchors=False))
    one, other = (
        rasterise(device, uploaded, upload_view(device, close, RenderSettings()), chosen)
        for chosen in (DEFAULT, options)
    )
    assert len(one.activations.visible) < 0.9 * len(other.activations.visible)
    image = device.download(one.image)
    assert np.abs(image).max() > 0
    assert np.array_equal(image, device.download(other.image))


@pytest.mark.parametrize("max_memory", [None, 1 << 18])
@pytest.mark.parametrize("room", [EXACT_ROOM, Room(1000, 9000, 90_000)])
def test_pictures_without_gradients_have_the_same_bits(device, max_memory, room):
    scene, camera = anchor_scene(2000, 80, 3)
    uploaded, options = upload_scene(device, scene), RenderOptions(max_memory=max_memory)
    view = upload_view(device, camera, RenderSettings(background=(0.1, 0.4, 0.9)))
    frame = rasterise(device, uploaded, view, options, room)
    picture = rasterise(device, uploaded, view, options, room, keep=False)
    totals = [[int(device.download(t)[0]) for t in one.totals] for one in (frame, picture)]
    assert totals[0] == totals[1]
    assert min(totals[0]) > 0
    assert np.array_equal(device.download(frame.image), device.download(picture.image))


def test_a_room_grows_only_if_it_must():
    room = Room(10, EXACT, 30)
    assert room.holds(Room(10, 2**40, 30))
    assert not any(room.holds(needed) for needed in (Room(11, 0, 0), Room(0, 0, 31)))
    grown = room.grown(Room(10, 4, 40))
    assert grown == Room(10, 4 + 1 + 1024, 40 + 10 + 1024)
    assert grown.grown(Room(10, 5, 41)) == grown


def test_gradients_need_what_was_kept_of_the_same_scene(device, rng):
    scene, camera = anchor_scene(100, 32, 3)
    uploaded, gaussians = upload_scene(device, scene), stored(rng, 50).map(device.upload)
    view, d_image = upload_view(device, camera, RenderSettings()), device.zeros((3, 32, 32))
    fused = rasterise(device, uploaded, view, keep=False)
    with pytest.raises(ValueError, match="drawn without `keep`"):
        rasterise_backward(device, uploaded, fused, d_image)
    with pytest.raises(ValueError, match="of ordinary Gaussians, but the scene is one of anchors"):
        rasterise_backward(device, uploaded, rasterise(device, gaussians, view), d_image)
