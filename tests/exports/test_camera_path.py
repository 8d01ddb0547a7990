"""Paths of cameras: where they lead, what they look at, and as files in nerfstudio's form."""

import json
from dataclasses import replace

import numpy as np
import pytest

from clgs.errors import DataError
from clgs.exports.camera_path import (
    interpolate,
    look_at,
    orbit,
    pinhole,
    read_camera_path,
    spiral,
    through_photos,
    walking_order,
    write_camera_path,
)
from clgs.exports.framing import common_up, fov_y, frame_cameras, frame_scene
from clgs.scene.gaussians import OrdinaryGaussians
from clgs.scene.scene import SplatScene
from tests.codec.scenes import random_scene

UP = np.array([0.0, 0.0, 1.0])
CENTRE = np.array([0.5, -1.0, 0.25])


def ring(count, arc=2 * np.pi, radius=3.0, height=1.0):
    """Cameras on a ring around CENTRE that look at it."""
    cameras = []
    for angle in arc * np.arange(count) / count:
        eye = CENTRE + np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        cameras.append(pinhole(look_at(eye, CENTRE, UP), eye, 40.0, (60, 40)))
    return cameras


def ball(rng, count=500):
    """A ball of splats around CENTRE, and a few floaters far away."""
    mean = CENTRE + 0.3 * rng.normal(size=(count, 3)) * [1, 1, 0.3]
    mean[:5] *= 1000
    arrays = mean, np.full((count, 3), -4.0), np.tile([1.0, 0, 0, 0], (count, 1)), np.ones(count)
    sh = np.zeros((count, 1, 3))
    return SplatScene(OrdinaryGaussians(*(a.astype(np.float32) for a in (*arrays, sh))))


def seen_at(camera, point):
    """Where the camera sees a point, in pixels; it must lie before it."""
    x, y, z = camera.rotation @ point + camera.translation
    assert z > 0
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def test_a_camera_that_looks_at_a_point_has_it_in_the_middle_and_its_up_up(rng):
    for eye in rng.normal(size=(20, 3)) * 3:
        camera = pinhole(look_at(eye, CENTRE, UP), eye, 50.0, (80, 60))
        np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.rotation) > 0
        np.testing.assert_allclose(camera.centre, eye, atol=1e-12)
        np.testing.assert_allclose(seen_at(camera, CENTRE), [40, 30], atol=1e-9)
        assert seen_at(camera, CENTRE + 0.01 * UP)[1] < 30
        assert fov_y(camera) == pytest.approx(50.0)
    down = look_at(CENTRE + UP, CENTRE, UP)
    np.testing.assert_allclose(down @ down.T, np.eye(3), atol=1e-12)


def test_an_orbit_repeats_the_ring_of_the_cameras(rng):
    cameras = ring(24)
    framing = frame_cameras(cameras, frame_scene(ball(rng), (80, 60)))
    np.testing.assert_allclose(framing.centre, CENTRE, atol=1e-9)
    np.testing.assert_allclose(framing.up, UP, atol=1e-9)
    assert framing.closed
    frames = orbit(framing, 36)
    for camera in frames:
        offset = camera.centre - CENTRE
        assert offset[2] == pytest.approx(1.0)
        assert np.hypot(*offset[:2]) == pytest.approx(3.0)
        np.testing.assert_allclose(seen_at(camera, CENTRE), [30, 20], atol=1e-6)
        assert fov_y(camera) == pytest.approx(40.0)
    places = np.array([camera.centre for camera in [*frames, frames[0]]])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)


def test_an_orbit_of_an_open_ring_stays_between_its_ends(rng):
    cameras = ring(16, arc=np.pi / 2)
    framing = frame_cameras(cameras, frame_scene(ball(rng), (80, 60)))
    assert not framing.closed
    allowed = np.array([camera.centre for camera in cameras])
    for camera in orbit(framing, 20):
        # the ends of the arc lie among the cameras: no farther from one than a step
        assert np.linalg.norm(allowed - camera.centre, axis=1).min() < 0.5


def test_without_cameras_the_middle_is_that_of_the_splats_and_floaters_do_not_count(rng):
    framing = frame_scene(ball(rng), (80, 60))
    np.testing.assert_allclose(framing.centre, CENTRE, atol=0.1)
    np.testing.assert_allclose(framing.up, UP)  # it is flat along z
    distance = np.hypot(framing.ring, framing.height)
    assert 0.5 < distance < 3
    chosen = frame_scene(ball(rng), (80, 60), np.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(chosen.up, [0, -1, 0])
    for camera in orbit(chosen, 5):
        np.testing.assert_allclose(seen_at(camera, chosen.centre), [40, 30], atol=1e-9)


def test_scenes_of_anchors_and_empty_ones_have_a_frame(rng):
    scene = random_scene(rng, 50)
    assert np.isfinite(orbit(frame_scene(scene, (80, 60)), 4)[1].centre).all()
    nothing = SplatScene(ball(rng).gaussians.map(lambda array: array[:0]))
    assert np.isfinite(orbit(frame_scene(nothing, (80, 60)), 4)[1].centre).all()


def test_cameras_side_by_side_have_a_centre_before_them(rng):
    before = CENTRE - np.array([0, 3, 0])
    eyes = before + 0.3 * rng.normal(size=(12, 3)) * [1, 0.1, 1]
    turn = look_at(before, CENTRE, UP)
    cameras = [pinhole(turn, eye, 40.0, (60, 40)) for eye in eyes]
    framing = frame_cameras(cameras, frame_scene(ball(rng), (80, 60)))
    np.testing.assert_allclose(framing.up, UP, atol=1e-9)
    assert 2 < framing.centre[1] - np.mean(eyes[:, 1]) < 4
    for camera in spiral(framing, 16):
        assert np.linalg.norm(camera.centre - eyes.mean(axis=0)) < 1.5
        np.testing.assert_allclose(seen_at(camera, framing.centre), [30, 20], atol=1e-6)


def test_up_is_found_for_cameras_that_look_down():
    cameras = ring(12, arc=np.pi, height=4.0)
    np.testing.assert_allclose(common_up(cameras), UP, atol=1e-9)


def test_a_way_through_cameras_meets_each_and_does_not_jump():
    cameras = ring(8, arc=np.pi)
    frames = interpolate(cameras, 200)
    assert len(frames) == 200
    places = np.array([camera.centre for camera in frames])
    for camera in cameras:
        nearest = int(np.argmin(np.linalg.norm(places - camera.centre, axis=1)))
        # half a frame's way, and as much turned
        assert np.linalg.norm(places[nearest] - camera.centre) < 0.05
        turned = frames[nearest].rotation @ camera.rotation.T
        assert np.arccos(min(1.0, (np.trace(turned) - 1) / 2)) < 0.05
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() < 2.5 * np.median(steps)
    np.testing.assert_allclose(places[0], cameras[0].centre, atol=1e-9)
    np.testing.assert_allclose(places[-1], cameras[-1].centre, atol=1e-9)


def test_one_camera_and_cameras_in_one_place_make_a_path():
    one = ring(1)
    assert interpolate(one, 3) == one * 3
    same = [ring(1)[0]] * 3
    for camera in interpolate(same, 5):
        np.testing.assert_allclose(camera.centre, same[0].centre, atol=1e-9)


def test_the_lens_goes_along_and_the_raster_stays():
    wide, narrow = ring(2)
    narrow = replace(narrow.resized(30, 20), fx=2 * narrow.fx / 2, fy=2 * narrow.fy / 2)
    frames = interpolate([wide, narrow], 3)
    assert {(c.width, c.height) for c in frames} == {(60, 40)}
    assert frames[2].fy == pytest.approx(2 * frames[0].fy)
    assert frames[0].fy < frames[1].fy < frames[2].fy


def test_photos_without_order_are_put_into_one(rng):
    cameras = ring(40)
    centres = np.array([camera.centre for camera in cameras])
    assert walking_order(centres) == list(range(40))
    mixed = rng.permutation(40)
    order = walking_order(centres[mixed])
    steps = np.linalg.norm(np.diff(centres[mixed][order], axis=0), axis=1)
    assert sorted(order) == list(range(40))
    assert np.median(steps) < 0.6
    frames = through_photos([cameras[i] for i in mixed], 30)
    assert len(frames) == 30


POSE = np.eye(4).ravel().tolist()
FAR = [1e300, *POSE[1:]]


def written(tmp_path, record):
    path = tmp_path / "path.json"
    path.write_text(record if isinstance(record, str) else json.dumps(record))
    return path


def record(**changes):
    return {
        "camera_type": "perspective", "render_width": 64, "render_height": 48, "fps": 24,
        "camera_path": [{"camera_to_world": POSE, "fov": 60, "aspect": 4 / 3}],
    } | changes  # fmt: skip


def assert_same(found, wanted):
    for mine, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(mine.rotation, theirs.rotation, atol=1e-9)
        np.testing.assert_allclose(mine.translation, theirs.translation, atol=1e-9)
        np.testing.assert_allclose(mine.fx, theirs.fx, rtol=1e-9)
        np.testing.assert_allclose(mine.fy, theirs.fy, rtol=1e-9)
        assert (mine.width, mine.height) == (theirs.width, theirs.height)


def test_what_is_written_is_read(tmp_path):
    cameras = ring(5)
    write_camera_path(tmp_path / "p.json", cameras, 25.0)
    found, fps = read_camera_path(tmp_path / "p.json")
    assert fps == 25
    assert_same(found, cameras)


def test_axes_and_angle_are_those_of_opengl(tmp_path):
    """The identity looks along -z, y up; fov is vertical."""
    camera = read_camera_path(written(tmp_path, record()))[0][0]
    np.testing.assert_allclose(camera.rotation, np.diag([1, -1, -1]), atol=1e-12)
    assert camera.fy == pytest.approx(24 / np.tan(np.radians(30)))
    assert camera.fx == camera.fy
    assert (camera.cx, camera.cy, camera.width, camera.height) == (32, 24, 64, 48)


def test_keyframes_are_read_by_rows_and_by_columns(tmp_path):
    cameras = ring(3)
    write_camera_path(tmp_path / "path.json", cameras, 30)
    frames = json.loads((tmp_path / "path.json").read_text())["camera_path"]
    poses = [np.array(frame["camera_to_world"]).reshape(4, 4) for frame in frames]
    size = {"render_width": 60, "render_height": 40, "camera_path": []}
    by_row = [{"matrix": pose.ravel().tolist(), "fov": 40} for pose in poses]
    by_column = [{"matrix": json.dumps(pose.T.ravel().tolist()), "fov": 40} for pose in poses]
    for keyframes in (by_row, by_column):
        found, _ = read_camera_path(written(tmp_path, record(keyframes=keyframes, **size)))
        assert_same(found, cameras)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not a JSON file"),
        ("[]", "not an object"),
        ("[" * 100_000, "not a JSON file"),
        (record(camera_path=[]), "camera_path: has no cameras"),
        (record(camera_path={}), "camera_path: has no cameras"),
        (record(camera_path=[7]), r"camera_path\[0\]: not an object"),
        (record(camera_type="equirectangular"), "camera_type: 'equirectangular'"),
        (record(render_width=0), "render_width: 0 is not a number from 1"),
        (record(render_height="800"), "render_height: 800 is not a number"),
        (record(fps=float("nan")), "fps: nan"),
        (record(camera_path=[{"fov": 50}]), r"camera_path\[0\].camera_to_world: 16 numbers"),
        (
            record(camera_path=[{"camera_to_world": [*POSE[:3], "1_0", *POSE[4:]]}]),
            r"camera_path\[0\].camera_to_world: 16 numbers",
        ),
        (record(camera_path=[{"camera_to_world": POSE, "fov": 0}]), r"camera_path\[0\].fov: 0"),
        (record(camera_path=[{"camera_to_world": POSE[:9]}]), "camera_to_world: 16 numbers"),
        (record(camera_path=[{"camera_to_world": [0.0] * 16}]), "its rotation is none"),
        (record(camera_path=[{"camera_to_world": "x"}]), "camera_to_world: 16 numbers"),
        (record(camera_path=[{"camera_to_world": [float("inf")] * 16}]), "16 numbers below 1e.12"),
        (record(camera_path=[{"camera_to_world": FAR}]), "16 numbers below 1e.12"),
        (record(camera_path=[{"matrix": POSE[:9]}]), "matrix: 16 numbers"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(DataError, match=rf"path\.json: .*{said}"):
        read_camera_path(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match=r"no\.json: no such file"):
        read_camera_path(tmp_path / "no.json")
