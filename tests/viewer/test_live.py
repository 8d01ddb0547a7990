"""What the viewer draws, without a browser."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from clgs.data.images import Pixels
from clgs.data.view import StoredPhoto, View
from clgs.lab.scenes import anchor_scene
from clgs.render.renderer import Renderer
from clgs.scene.scene import RenderSettings, SplatScene
from clgs.train.quality.scores import to_8bit
from clgs.viewer.live import (
    ERROR,
    HALVES,
    MOVING_LEAST,
    PHOTO,
    RENDER,
    Eye,
    Follower,
    LiveScene,
    compare,
    eye_of,
    names_of,
    scene_importance,
    splat_importance,
    stands_at,
)
from tests.codec.scenes import random_scene
from tests.exports.test_camera_path import ring
from tests.ops.cases.splats import stored


@pytest.fixture
def cpu(open_device):
    return open_device("cpu")


def test_an_eye_where_a_camera_stands_sees_its_picture(cpu):
    scene, camera = anchor_scene(1500, 96, 2)
    live = LiveScene(cpu, scene, np.arange(len(scene.anchors))[::-1].astype(float))
    eye = eye_of(camera, (96, 96))
    again = eye.camera(96)
    np.testing.assert_allclose(again.rotation, camera.rotation, atol=1e-9)
    np.testing.assert_allclose(again.translation, camera.translation, atol=1e-9)
    assert again.fy == pytest.approx(camera.fy)
    error = live.picture(again).astype(int) - to_8bit(Renderer(cpu, scene).render(camera))
    assert np.abs(error).max() <= 1
    for turned in ring(5):
        round_trip = eye_of(turned, (60, 40)).camera(40)
        np.testing.assert_allclose(round_trip.rotation, turned.rotation, atol=1e-9)
        np.testing.assert_allclose(round_trip.centre, turned.centre, atol=1e-9)


def test_a_window_of_another_shape_holds_the_whole_picture(cpu):
    camera = anchor_scene(10, 96, 2)[1]
    for size in ((300, 100), (100, 300)):
        found = eye_of(camera, size).camera(size[1])
        assert (found.width, found.height) == size
        assert found.width / found.fx >= camera.width / camera.fx - 1e-9
        assert found.height / found.fy >= camera.height / camera.fy - 1e-9


def test_moving_pictures_are_coarse_and_bounded(cpu):
    scene, camera = anchor_scene(1500, 96, 2)
    live = LiveScene(cpu, scene, np.ones(len(scene.anchors)))
    eye = eye_of(camera, (1200, 800))
    assert live.moving_rows(eye) == MOVING_LEAST
    live.picture(eye.camera(200))
    assert MOVING_LEAST <= live.moving_rows(eye) <= 800
    assert eye.camera(10**6).height == 800
    assert Eye(eye.wxyz, eye.position, eye.fov, (1, 1)).camera(5).width == 1


def test_a_share_keeps_what_matters_most(cpu):
    scene, camera = anchor_scene(1500, 96, 2)
    count = len(scene.anchors)
    live = LiveScene(cpu, scene, np.arange(count, dtype=float))
    part = live.picture(camera, 0.25)
    kept = live.kept(0.25)
    assert kept == round(0.25 * count)
    last = scene.anchors.map(lambda array: array[count - kept :])
    wanted = to_8bit(Renderer(cpu, replace(scene, anchors=last)).render(camera))
    assert np.array_equal(part, wanted)
    assert np.array_equal(live.picture(camera), to_8bit(Renderer(cpu, scene).render(camera)))
    assert live.kept(0) == 1


def test_ordinary_gaussians_are_shown_by_opacity_and_area(cpu, rng):
    gaussians = stored(rng, 300)
    live = LiveScene(cpu, SplatScene(gaussians), splat_importance(gaussians))
    assert live.picture(ring(1)[0], 0.5).shape == (40, 60, 3)
    gaussians.opacity[7], gaussians.log_scale[7] = 9.0, 1.0
    assert np.argmax(splat_importance(gaussians)) == 7


def test_importance_needs_no_cameras_and_takes_some(cpu, rng):
    scene = random_scene(rng, 60)
    assert scene_importance(cpu, scene, []).shape == (len(scene.anchors),)
    seen = []
    found = scene_importance(cpu, scene, ring(30), on_render=lambda: seen.append(1))
    assert found.shape == (len(scene.anchors),)
    assert 0 < len(seen) <= 24


def test_a_follower_draws_coarse_then_fine_and_ends():
    drawn, fine = [], threading.Event()

    def draw(moving):
        drawn.append(moving)
        if not moving:
            fine.set()

    follower = Follower(draw, rest=0.0)
    for _ in range(3):
        fine.clear()
        follower.move()
        assert fine.wait(60)
    follower.stop()
    assert drawn[0] is True
    assert drawn[-1] is False
    assert drawn.count(False) <= drawn.count(True)


def photo_view(camera, level=200):
    picture = np.full((camera.height, camera.width, 3), level, np.uint8)
    picture[: camera.height // 2] //= 2
    return View("a", camera, StoredPhoto.of(Pixels(picture, None)))


def test_a_photo_lies_over_the_render_where_it_was_taken():
    view = photo_view(ring(1)[0])
    there = eye_of(view.camera, (180, 80)).camera(80)
    assert stands_at(there, view)
    assert not stands_at(replace(there, translation=there.translation + 0.1), view)
    assert not stands_at(ring(9)[1], view)
    render = np.zeros((80, 180, 3), np.uint8)
    black = RenderSettings().background
    assert compare(render, there, view, black, RENDER) is render
    photo = compare(render, there, view, black, PHOTO)
    assert not photo[:, :30].any()  # next to the photo is render
    assert not photo[:, 150:].any()
    assert (photo[:30, 30:150] == 100).all()
    assert (photo[50:, 30:150] == 200).all()
    halves = compare(render, there, view, black, HALVES)
    assert (halves[50:, 30:90] == 200).all()
    assert not halves[:, 90:].any()
    error = compare(photo, there, view, black, ERROR)
    assert (error[50:, 30:150] == error[60, 90]).all()


def test_photos_of_one_name_can_be_told_apart():
    view = photo_view(ring(1)[0])
    assert names_of([view, view]) == ["a", "a (2)"]
