"""What scenes know of their photos: its bounds, and how it goes through all kinds of files."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.meta import pack_phot, unpack_phot
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.constants import BLUR, NEAR_PLANE
from clgs.data.splats.anchors import load_scaffold, save_scaffold
from clgs.errors import CodecError
from clgs.exports.camera_path import look_at
from clgs.ops import project
from clgs.reference import project as reference
from clgs.render.frame import screen_of
from clgs.scene.camera import PULL, SLACK, UNKNOWN, Camera, PhotoRange, photo_range
from clgs.scene.storage import load_scene, save_scene
from codec_c.reader.files import read_file
from tests.codec.container.damage import contents, rebuilt
from tests.codec.scenes import random_scene

PHOTOS = PhotoRange(300.0, 310.5, 0.25, -1.0, 2.0, 3.0, 4.5)


def cameras_around(rng, count, middle, distance):
    """Cameras between ``distance`` from ``middle``, which all look at it."""
    found = []
    for _ in range(count):
        outward = rng.normal(size=3)
        eye = middle + rng.uniform(*distance) * outward / np.linalg.norm(outward)
        rotation = np.stack(look_at(eye, middle, np.array([0.1, 0.2, 1.0])))
        found.append(Camera(rotation, -rotation @ eye, 300.0, 300.0, 80.0, 60.0, 160, 120))
    return found


def scene_of(photos):
    scene = random_scene(np.random.default_rng(4), 300)
    scene.settings = replace(scene.settings, photos=photos)
    return scene


def test_the_point_and_the_distances_are_those_of_the_cameras(rng):
    middle = np.array([0.4, -0.3, 0.2])
    cameras = cameras_around(rng, 60, middle, (3.0, 4.0))
    cameras[5] = replace(cameras[5], fx=330.0)
    found = photo_range(cameras)
    assert (found.least_focal, found.greatest_focal) == (300.0, 330.0)
    assert np.array(found[2:5]) == pytest.approx(middle, abs=20 * PULL)
    away = [np.linalg.norm(camera.centre - np.array(found[2:5])) for camera in cameras]
    assert found.nearest == pytest.approx(min(away) * (1 - SLACK))
    assert found.farthest == pytest.approx(max(away) * (1 + SLACK))
    assert found.problem() == ""


def test_one_camera_and_parallel_ones_have_a_range_and_none_has_no(rng):
    (one,) = cameras_around(rng, 1, np.zeros(3), (3.0, 3.0))
    other = replace(one, translation=one.translation + np.array([0.5, 0, 0]))
    for cameras in ([one], [one, one], [one, other]):
        found = photo_range(cameras)
        assert found.problem() == ""
        assert found.farthest < 1
    assert photo_range([]) == UNKNOWN


def test_photos_are_shown_as_they_were_learned(rng):
    """No Gaussian has another blur than in training for a camera of the photos."""
    cameras = cameras_around(rng, 40, np.array([0.4, -0.3, 0.2]), (2.0, 4.0))
    mean = rng.normal(size=(500, 3)) * 3
    photos = photo_range(cameras)
    for camera in cameras:
        view = reference.unpack(camera.pack(NEAR_PLANE))
        blur, learned = reference.blurs(view, mean, screen_of(camera, photos))
        np.testing.assert_array_equal(blur, BLUR)
        np.testing.assert_array_equal(learned, BLUR)
    assert screen_of(cameras[0], UNKNOWN) == project.USUAL_SCREEN


@pytest.mark.parametrize(
    ("x", "y", "square"),
    [(4.0, 4.0, 16.0), (0.25, 0.25, 1 / 16), (4.0, 1.0, 1.0), (1.0, 0.25, 1.0), (4.0, 2.0, 4.0),
     (0.25, 0.5, 1 / 4), (2.0, 0.5, 1.0)],
)  # fmt: skip
def test_another_size_is_told_by_the_focal_lengths(rng, x, y, square):
    """If pixels are stretched, the axis counts on which the size differs less."""
    camera = cameras_around(rng, 1, np.zeros(3), (3.0, 3.0))[0]
    other = replace(camera, fx=x * camera.fx, fy=y * camera.fy)
    screen = screen_of(other, photo_range([camera]))
    view = reference.unpack(camera.pack(NEAR_PLANE))
    assert reference.blurs(view, np.zeros((1, 3)), screen)[1] == pytest.approx(BLUR * square)


def test_bitstreams_and_archives_keep_it_to_the_last_bit(tmp_path):
    scene = scene_of(PHOTOS)
    data = encode(scene)
    assert decode(data).settings == scene.settings
    assert decode(encode(scene, layers=2)).settings == scene.settings
    found = describe(data)
    assert (found["version"], found["sections"]["PHOT"]) == ("1.3", 56)
    assert PhotoRange(**found["settings"]["photos"]) == PHOTOS
    assert read_file(data).meta.blur == scene.settings.blur  # that reader passes it over
    save_scene(tmp_path / "scene.npz", scene)
    assert load_scene(tmp_path / "scene.npz").settings == scene.settings
    save_scaffold(tmp_path / "scene.ply", scene)
    assert load_scaffold(tmp_path / "scene.ply").settings == scene.settings


def test_scenes_without_it_are_written_as_ever(tmp_path):
    scene = scene_of(UNKNOWN)
    data = encode(scene)
    assert describe(data)["version"] == "1.0"
    assert "PHOT" not in contents(data)
    save_scene(tmp_path / "scene.npz", scene)
    with np.load(tmp_path / "scene.npz") as archive:
        assert "settings.photos" not in archive.files
    assert load_scene(tmp_path / "scene.npz").settings == scene.settings


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        pack_phot(PHOTOS) + b"\0",
        pack_phot(UNKNOWN),
        pack_phot(PHOTOS._replace(least_focal=0.0)),
        pack_phot(PHOTOS._replace(least_focal=311.0)),
        pack_phot(PHOTOS._replace(y=float("nan"))),
        pack_phot(PHOTOS._replace(farthest=float("inf"))),
        pack_phot(PHOTOS._replace(nearest=-1.0)),
        struct.pack("<7d", 300, 300, 0, 0, 0, 5, 4),
    ],
)
def test_damaged_sections_are_refused(bad):
    with pytest.raises(ValueError, match=r"instead of 56|lengths|distances|finite|nothing"):
        unpack_phot(bad)
    data = encode(scene_of(PHOTOS))
    with pytest.raises(CodecError, match="section PHOT at byte"):
        decode(rebuilt(data, PHOT=bad))


def test_numbers_that_cannot_be_are_not_written():
    with pytest.raises(CodecError, match="photos: distances from"):
        encode(scene_of(PHOTOS._replace(nearest=5.0)))
