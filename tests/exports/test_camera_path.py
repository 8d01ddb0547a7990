"""Camera paths in nerfstudio's form."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clgs.errors import DataError
from clgs.exports.camera_path import read_camera_path, write_camera_path
from tests.exports.test_paths import ring

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
