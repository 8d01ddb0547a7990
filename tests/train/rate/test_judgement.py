"""What changes of the anchors are said to cost, against what they do cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clgs.data.images import Pixels
from clgs.data.view import StoredPhoto, View
from clgs.lab.scenes import anchor_scene
from clgs.opencl.device import Device
from clgs.ops import loss
from clgs.render.frame import EXACT_ROOM, DeviceScene, Frame, upload_scene, upload_view
from clgs.render.rasterise import rasterise
from clgs.scene.scene import RenderSettings, Scene
from clgs.train.config import TrainConfig
from clgs.train.quality.importance import sensitivity
from clgs.train.quality.scores import to_8bit
from clgs.train.rate.pricing import compare, judge, look
from clgs.train.state.run_state import ANCHOR_GROUPS

VIEWS = 24
CONFIG = TrainConfig()
WEIGHTS = loss.Weights(CONFIG.l1_weight, CONFIG.ssim_weight)


@pytest.fixture(scope="module")
def seen(device):
    """A scene, and a noisy photo of it."""
    scene, camera = anchor_scene(300, 48)
    frame = rasterise(
        device, upload_scene(device, scene), upload_view(device, camera, RenderSettings())
    )
    image = to_8bit(device.download(frame.image))
    noise = np.random.default_rng(1).integers(-6, 7, image.shape)
    photo = np.clip(image + noise, 0, 255).astype(np.uint8)
    return scene, View("front", camera, StoredPhoto.of(Pixels(photo, None)))


def picture(device: Device, scene: Scene, view: View) -> np.ndarray:
    uploaded = upload_scene(device, scene)
    return device.download(
        rasterise(device, uploaded, upload_view(device, view.camera, RenderSettings())).image
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["offset", "feature", "scaling"])
def test_curvature_is_the_squared_length_of_the_derivative(device, seen, name):
    scene, view = seen
    cameras = [view.camera] * VIEWS
    uploaded = upload_scene(device, scene)
    found = sensitivity(device, uploaded, RenderSettings(), cameras).curvature[name] / VIEWS
    # The largest elements: there, differences of float32 pictures say most.
    checked = np.argsort(found.reshape(-1))[-24:]
    exact = []
    for element in checked:
        sides = []
        for step in (-2e-3, 2e-3):
            moved = getattr(scene.anchors, name).copy()
            moved.reshape(-1)[element] += step
            anchors = replace(scene.anchors, **{name: moved})
            sides.append(picture(device, replace(scene, anchors=anchors), view))
        derivative = (sides[1].astype(np.float64) - sides[0]) / 4e-3
        exact.append(np.square(derivative).sum())
    # 24 draws of one number have a standard error of sqrt(2 / 24) = 0.29; the largest are picked.
    ratio = found.reshape(-1)[checked] / np.array(exact)
    assert 0.6 < np.median(ratio) < 2.0


def test_the_room_that_earlier_views_left_changes_nothing(device, monkeypatch):
    scene, camera = anchor_scene(8000, 64)
    uploaded, settings = upload_scene(device, scene), RenderSettings()
    aside = replace(camera, cx=camera.cx + 0.9 * camera.width)
    frames = (
        rasterise(device, uploaded, upload_view(device, one, settings)) for one in (aside, camera)
    )
    fewer, more = (frame.needed(device) for frame in frames)
    assert fewer.entries + fewer.entries // 4 + 1024 < more.entries
    cameras = [aside, camera, aside]
    found = sensitivity(device, uploaded, settings, cameras)

    def exact_room(draw: Callable[..., Frame], *arguments: object):
        return draw(*arguments[:-1], EXACT_ROOM), EXACT_ROOM

    monkeypatch.setattr(f"{sensitivity.__module__}.with_enough_room", exact_room)
    exact = sensitivity(device, uploaded, settings, cameras)
    np.testing.assert_array_equal(found.importance, exact.importance)
    np.testing.assert_array_equal(found.seen, exact.seen)
    for name, curvature in exact.curvature.items():
        np.testing.assert_array_equal(found.curvature[name], curvature)
    flat = sensitivity(device, uploaded, settings, cameras, curved=False)
    np.testing.assert_array_equal(flat.importance, exact.importance)
    assert not flat.curvature


def judged(device: Device, seen: tuple[Scene, View], scene: DeviceScene, unseen_stay: bool = False):
    found = look(device, CONFIG, scene, [seen[1]] * VIEWS)
    return judge(found, *compare(device, CONFIG, scene, [seen[1]] * VIEWS), unseen_stay)


def test_looks_are_means_over_the_views_asked(device, seen):
    scene, view = seen
    uploaded = upload_scene(device, scene)
    other = replace(view, camera=replace(view.camera, cx=view.camera.cx + 5.0))
    firsts, seconds = (look(device, CONFIG, uploaded, [one] * 2) for one in (view, other))
    for found, camera in ((firsts, view.camera), (seconds, other.camera)):
        halved = camera.reduced(2)  # there are many pixels for so few anchors
        sums = sensitivity(device, uploaded, RenderSettings(), [halved] * 2)
        np.testing.assert_allclose(found.importance, 4 * sums.importance / 2, rtol=1e-6)
    mixed = firsts.mean(seconds)
    np.testing.assert_allclose(
        mixed.curvature["feature"],
        (firsts.curvature["feature"] + seconds.curvature["feature"]) / 2,
        rtol=1e-6,
    )
    kept = np.arange(len(scene.anchors)) % 3 == 0
    left = mixed.rows(kept)
    np.testing.assert_array_equal(left.importance, mixed.importance[kept])
    np.testing.assert_array_equal(left.seen, (firsts.seen | seconds.seen)[kept])


def test_the_loss_is_that_of_the_views(device, seen):
    scene, view = seen
    uploaded = upload_scene(device, scene)
    frame = rasterise(device, uploaded, upload_view(device, view.camera, RenderSettings()))
    photo = device.upload(np.ascontiguousarray(view.photo.pixels().color.transpose(2, 0, 1)))
    value = loss.forward(device, frame.image, photo, WEIGHTS).value_later(device).get().value
    assert judged(device, seen, uploaded).loss == pytest.approx(value, rel=1e-6)


def test_what_an_anchor_saves_in_units_of_the_loss(device, seen):
    """Leaving out an anchor adds about e / (2 E) of the loss while that is small."""
    scene, view = seen
    found = judged(device, seen, upload_scene(device, scene))
    whole = picture(device, scene, view)
    photo = view.photo.pixels().color.transpose(2, 0, 1) / 255.0
    error = np.square(whole - photo).sum()
    order = np.argsort(found.importance)[::-1]
    exact = []
    for anchor in order[:12]:
        kept = np.arange(len(scene.anchors)) != anchor
        anchors = scene.anchors.map(lambda array, kept=kept: array[kept])
        change = picture(device, replace(scene, anchors=anchors), view) - whole
        exact.append(0.5 * found.loss * np.square(change).sum() / error)
    ratio = found.importance[order[:12]] / np.array(exact)
    assert 0.5 < np.median(ratio) < 2.0


def test_what_some_views_do_not_see_is_kept(device, seen):
    scene, view = seen
    position = scene.anchors.position.copy()
    position[:7] = view.camera.centre - 50.0 * view.camera.rotation[2]  # behind the camera
    hidden = replace(scene, anchors=replace(scene.anchors, position=position))
    uploaded = upload_scene(device, hidden)
    every, some = (judged(device, seen, uploaded, unseen_stay) for unseen_stay in (False, True))
    assert (every.importance[:7] == 0).all()
    assert not any(every.curvature(name)[:7].any() for name in ANCHOR_GROUPS)
    assert np.isinf(some.importance[:7]).all()
    assert np.isfinite(some.importance[7:]).all()
    for name in ANCHOR_GROUPS:
        array = some.curvature(name)
        np.testing.assert_array_equal(array[7:], every.curvature(name)[7:])
        assert array[0].max() > 0
