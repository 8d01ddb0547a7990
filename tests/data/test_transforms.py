"""Blender and nerfstudio folders: poses, intrinsics, splits, missing and bad input."""

import copy
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from clgs.data.dataset import load_dataset, read_photo_set
from clgs.data.posed_photo import Photo
from clgs.errors import DataError
from tests.data.folders import (
    noise_image,
    opengl,
    ring,
    save_json,
    write_blender,
    write_colmap,
    write_transforms,
)


def project(photo: Photo, point: np.ndarray) -> np.ndarray:
    local = photo.rotation @ point + photo.translation
    lens = photo.lens
    return np.array([lens.cx, lens.cy]) + local[:2] / local[2] * (lens.fx, lens.fy)


def test_known_pose(tmp_path):
    """A camera on the x axis looking at the origin: z up is image up, y right."""
    write_transforms(tmp_path, 3)
    photo = next(p for p in everything(tmp_path) if p.name == "images/000.png")
    assert photo.centre == pytest.approx([4.0, 0.0, 1.5])
    assert project(photo, np.zeros(3)) == pytest.approx([20.0, 15.0])
    assert project(photo, np.array([0.0, 0.0, 0.5]))[1] < 15.0
    assert project(photo, np.array([0.0, 0.5, 0.0]))[0] > 20.0


def everything(root: Path) -> list[Photo]:
    photos = read_photo_set(root)
    return photos.train + photos.test


def test_every_eighth_after_missing_ones_is_held_out(tmp_path):
    write_transforms(tmp_path, 20)
    (tmp_path / "images" / "000.png").unlink()
    (tmp_path / "images" / "005.png").unlink()
    photos = read_photo_set(tmp_path)
    assert photos.missing == ["images/000.png", "images/005.png"]
    assert [p.name[-7:-4] for p in photos.test] == ["001", "010", "018"]
    assert len(photos.train) == 15


@pytest.mark.parametrize(
    ("train", "test", "val", "trained", "tested", "said"),
    [
        ("02", "1", None, "02", "1", ""),
        ("0125", None, None, "0125", "34", ""),
        ("0125", "", "", "0125", "34", ""),
        ("0125", "", None, "0125", "34", ""),
        ("0125", "", "3", "0125", "3", ""),
        (None, "", "", "012345", "", ""),
        (None, None, "1", "02345", "1", ""),
        (None, "1", "2", "0345", "1", ""),
        ("012", "1", "2", "0", "1", "images/001.png, images/002.png is held out as well"),
        ("09", "1", None, "0", "1", "train_filenames: no frame has the name images/009.png"),
    ],
)
def test_own_split_is_honoured(tmp_path, caplog, train, test, val, trained, tested, said):
    listed = {
        f"{key}_filenames": [f"./images/00{number}.png" for number in numbers]
        for key, numbers in (("train", train), ("test", test), ("val", val))
        if numbers is not None
    }
    write_transforms(tmp_path, 6, **listed)
    photos = read_photo_set(tmp_path)
    assert "".join(p.name[-5] for p in photos.train) == trained
    assert "".join(p.name[-5] for p in photos.test) == tested
    assert said in caplog.text
    assert bool(said) == bool(caplog.text)


def test_a_listed_name_that_no_frame_has_is_told(tmp_path, caplog):
    write_transforms(tmp_path, 6, test_filenames=["images/001", "nope.jpg"])
    assert [p.name for p in read_photo_set(tmp_path).test] == ["images/001.png"]
    said = f"{tmp_path / 'transforms.json'}: test_filenames: no frame has the name nope.jpg"
    assert [one.getMessage() for one in caplog.records] == [said]


@pytest.mark.parametrize("form", ["{}", "{}.PNG", "/home/me/set/images/{}.png", "images\\{}.png"])
def test_a_list_may_name_its_photos_as_another_machine_does(tmp_path, caplog, form):
    write_transforms(tmp_path, 6, train_filenames=[form.format(f"00{n}") for n in (1, 4)])
    photos = read_photo_set(tmp_path)
    assert [p.name for p in photos.train] == ["images/001.png", "images/004.png"]
    assert len(photos.test) == 4
    assert not caplog.text


def test_a_list_that_names_no_photo_is_told_and_not_guessed(tmp_path):
    document = write_transforms(tmp_path, 6)
    (tmp_path / "other").mkdir()
    (tmp_path / "images" / "001.png").rename(tmp_path / "other" / "000.png")
    document["frames"][1]["file_path"] = "other/000.png"
    for names in ([], ["nope.png"], ["000.png"]):  # the last fits two photos
        save_json(tmp_path, document | {"train_filenames": names})
        with pytest.raises(DataError, match="train_filenames lists no photo of a frame"):
            read_photo_set(tmp_path)


def test_points_that_the_file_names_are_taken(tmp_path, caplog):
    document = write_transforms(tmp_path, 6, ply_file_path="sparse_pc.ply")
    assert read_photo_set(tmp_path).points_file is None
    assert "there is no file sparse_pc.ply; points are sought in the photos" in caplog.text
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    trimesh.PointCloud(points).export(tmp_path / "sparse_pc.ply")
    found = load_dataset(tmp_path)
    world = found.points / found.transform.scale + np.array(found.transform.centre)
    np.testing.assert_allclose(world, points, atol=1e-5)
    save_json(tmp_path, document | {"ply_file_path": "../sparse_pc.ply"})
    with pytest.raises(DataError, match=r"ply_file_path: path '../sparse_pc.ply' must stay"):
        read_photo_set(tmp_path)


@pytest.mark.parametrize(
    ("own", "expected"),
    [
        ({"fl_x": 60.0, "fl_y": 61.0, "cx": 19.0, "k1": 0.2}, (60, 61, 19, 15, 0.2, 0)),
        ({"fl_x": 60.0}, (60, 60, 18, 14, 0.1, 0.3)),
        ({"fl_y": 60.0}, (60, 60, 18, 14, 0.1, 0.3)),
        ({"camera_angle_x": 2 * math.atan(0.5)}, (40, 40, 18, 14, 0.1, 0.3)),
        ({"camera_angle_y": 2 * math.atan(0.5)}, (30, 30, 18, 14, 0.1, 0.3)),
        ({"k2": 0.5}, (50, 51, 18, 14, 0, 0.5)),
        ({"w": 80, "h": 60, "fl_x": 100.0, "cx": 38.0}, (50, 50, 19, 15, 0.1, 0.3)),
        ({}, (50, 51, 18, 14, 0.1, 0.3)),
    ],
)
def test_intrinsics_of_a_frame_win(tmp_path, own, expected):
    """What belongs together comes from one place, so that no lens is a mixture of two."""
    shared = {"fl_y": 51.0, "cx": 18.0, "cy": 14.0, "k1": 0.1, "k2": 0.3}
    document = write_transforms(tmp_path, 2, **shared)
    document["frames"][0] |= own
    save_json(tmp_path, document)
    first, second = (p.lens for p in sorted(everything(tmp_path), key=lambda p: p.name))
    for lens, values in ((first, expected), (second, (50, 51, 18, 14, 0.1, 0.3))):
        found = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.radial[:2])
        assert found == pytest.approx(values)


@pytest.mark.parametrize("own", [False, True])
def test_coefficients_may_be_a_list(tmp_path, own):
    """Nerfstudio writes k1 k2 k3 k4 p1 p2; single coefficients count less."""
    listed = [0.1, -0.02, 0.003, 0.0, 0.004, 0.005]
    document = write_transforms(tmp_path, 2, k1=0.3, camera_model="SIMPLE_RADIAL")
    for place in document["frames"] if own else [document]:
        place["distortion_params"] = listed
    save_json(tmp_path, document)
    for photo in everything(tmp_path):
        assert [*photo.lens.radial[:3], *photo.lens.tangential] == [*listed[:3], *listed[4:]]
    document["camera_model"] = "opencv_fisheye"  # any case
    save_json(tmp_path, document)
    lens = everything(tmp_path)[0].lens
    assert (lens.fisheye, *lens.radial) == (True, *listed[:4])
    for wrong in ([0.1], "0.1", [0.1, 0, 0, 0, 0, "x"], [0.1, 0, 0, 0, 0, 1e30]):
        document["frames"][0]["distortion_params"] = wrong
        save_json(tmp_path, document)
        message = r"frame 0: (distortion_params is not a list|p2 is not)"
        with pytest.raises(DataError, match=message):
            read_photo_set(tmp_path)


def test_no_mask_may_be_null(tmp_path):
    document = write_transforms(tmp_path, 2)
    for frame in document["frames"]:
        frame["mask_path"] = None
    save_json(tmp_path, document)
    assert [photo.mask for photo in everything(tmp_path)] == [None, None]


def test_angle_gives_focal_length_and_extension_is_found(tmp_path):
    frames = write_transforms(tmp_path, 2)["frames"]
    for frame in frames:
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    save_json(tmp_path, {"camera_angle_x": 2 * math.atan(0.5), "frames": frames})
    lens = read_photo_set(tmp_path).train[0].lens
    assert (lens.fx, lens.fy) == pytest.approx((40.0, 40.0))
    assert (lens.cx, lens.cy, lens.width, lens.height) == (20.0, 15.0, 40, 30)


def test_smaller_images_scale_the_intrinsics(tmp_path):
    write_transforms(tmp_path, 2, w=81, h=61, fl_x=100.0, cx=41.0)
    lens = read_photo_set(tmp_path).train[0].lens
    assert (lens.width, lens.height) == (40, 30)
    assert lens.fx == pytest.approx(100.0 * 40 / 81)
    assert lens.cx == pytest.approx(41.0 * 40 / 81)


@pytest.mark.parametrize("kind", ["transforms", "colmap"])
def test_a_centre_outside_of_its_photo_is_told(tmp_path, caplog, kind):
    if kind == "colmap":
        pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
        write_colmap(tmp_path, text=True)
        load_dataset(tmp_path)
        file = tmp_path / "sparse" / "0" / "cameras.txt"
        file.write_text(re.sub(r"(PINHOLE \S+ \S+ \S+ \S+) \S+", r"\1 5000", file.read_text()))
    else:
        write_transforms(tmp_path)
        load_dataset(tmp_path)
        write_transforms(tmp_path, cx=5000)
    assert "centre of the lens" not in caplog.text
    load_dataset(tmp_path)
    assert caplog.text.count("the centre of the lens, 5000 ") == 1
    assert "lies outside of 10 photos: " in caplog.text


@pytest.mark.parametrize("absent", ["w", "h", "wh"])
@pytest.mark.parametrize("centre", [(200, 150), (40, 30), (32.2, 24.0), (10, 7.5)])
def test_a_lens_for_photos_of_another_unknown_size_is_refused(tmp_path, absent, centre):
    sizes = {"w": 2 * round(centre[0]), "h": 2 * round(centre[1])}
    document = write_transforms(tmp_path, 2, fl_x=1000.0, cx=centre[0], cy=centre[1], **sizes)
    save_json(tmp_path, {name: document[name] for name in document if name not in absent})
    named = "{:g} {:g}".format(*centre)
    with pytest.raises(DataError, match=rf"frame 0: .* {named}, .* is 40x30; give the w and h"):
        read_photo_set(tmp_path)


@pytest.mark.parametrize("given", ["fl_x", "fl_x cx cy w h", "fl_x cx cy", "camera_angle_x"])
def test_a_focal_length_for_photos_of_no_known_size_is_told(tmp_path, caplog, given):
    document = write_transforms(tmp_path, 3, camera_angle_x=2 * math.atan(0.4))
    kept = {"frames", *given.split()}
    save_json(tmp_path, {name: value for name, value in document.items() if name in kept})
    assert read_photo_set(tmp_path).train[0].lens.fx == pytest.approx(50.0)
    said = f"{tmp_path / 'transforms.json'}: fl_x has no w and h; it is taken to be for photos of"
    assert caplog.text.count(said) == (given == "fl_x")
    assert ("40x30, which see 43.6 degrees across" in caplog.text) == (given == "fl_x")


def test_an_angle_tells_the_size_that_a_focal_length_is_for(tmp_path):
    frames = write_transforms(tmp_path, 3)["frames"]
    angle = 2 * math.atan(0.4)
    save_json(tmp_path, {"fl_x": 500.0, "fl_y": 500.0, "camera_angle_x": angle, "frames": frames})
    lens = read_photo_set(tmp_path).train[0].lens
    assert (lens.fx, lens.fy) == pytest.approx((50.0, 50.0))


def test_blender_split_and_pose(tmp_path):
    write_blender(tmp_path)
    photos = read_photo_set(tmp_path)
    assert (len(photos.train), len(photos.test)) == (8, 3)
    assert photos.train[3].name == "train/r_3.png"
    assert photos.train[0].centre == pytest.approx(ring(8)[0][:3, 3])
    assert photos.train[0].lens.fx == pytest.approx(40.0)


def set_pose(value: object) -> Callable[[dict], None]:
    return lambda document: document["frames"][1].update(transform_matrix=value)


def set_path(value: object) -> Callable[[dict], None]:
    return lambda document: document["frames"][1].update(file_path=value)


POSE = opengl(ring(3)[0])
SCALED = (np.array(POSE) * 2).tolist()
MIRRORED = (np.array(POSE) * [-1, 1, 1, 1]).tolist()
SHEARED = (np.array(POSE) @ [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).tolist()
FLAT = (np.array(POSE) * [1, 1, 0, 1]).tolist()
ZERO = [[0, 0, 0, 1], [0, 0, 0, 2], [0, 0, 0, 3], [0, 0, 0, 1]]
WITH_STRING = [["a", 0, 0, 0], *POSE[1:]]

BAD = {
    "frames missing": (lambda d: d.pop("frames"), "frames"),
    "frames empty": (lambda d: d.update(frames=[]), "frames"),
    "frames wrong": (lambda d: d.update(frames={"a": 1}), "frames"),
    "frame wrong": (lambda d: d["frames"].__setitem__(1, 7), "frame 1"),
    "model": (lambda d: d.update(camera_model="EQUIRECTANGULAR"), "camera_model.*unknown"),
    "model type": (lambda d: d.update(camera_model=3), "camera_model"),
    "focal text": (lambda d: d.update(fl_x="50"), "fl_x"),
    "focal zero": (lambda d: d.update(fl_x=0), "fl_x"),
    "focal tiny": (lambda d: d.update(fl_x=1e-300), "fl_x"),
    "focal huge": (lambda d: d.update(fl_y=1e300), "fl_y"),
    "no focal": (lambda d: (d.pop("fl_x"), d.pop("fl_y")), "camera_angle_x"),
    "angle": (lambda d: (d.pop("fl_x"), d.update(camera_angle_x=4)), "camera_angle_x"),
    "size": (lambda d: d.update(w=-1), "w, h"),
    "aspect": (lambda d: d.update(w=60), "intrinsics"),
    "no pose": (lambda d: d["frames"][1].pop("transform_matrix"), "frame 1.*transform_matrix"),
    "pose shape": (set_pose([[1, 0], [0, 1]]), "transform_matrix"),
    "pose ragged": (set_pose([[1, 0, 0, 0], [1], 3]), "transform_matrix"),
    "pose text": (set_pose(WITH_STRING), "transform_matrix"),
    "pose of other digits": (
        set_pose([[*POSE[0][:3], "\u0661"], *POSE[1:]]),
        "4x4 matrix of numbers",
    ),
    "pose underscore": (set_pose([[*POSE[0][:3], "1_0"], *POSE[1:]]), "4x4 matrix of numbers"),
    "pose scaled": (set_pose(SCALED), "not a rotation"),
    "pose mirrored": (set_pose(MIRRORED), "not a rotation"),
    "pose sheared": (set_pose(SHEARED), "not a rotation"),
    "pose singular": (set_pose(FLAT), "not a rotation"),
    "pose zero": (set_pose(ZERO), "not a rotation"),
    "pose transposed": (set_pose(np.array(POSE).T.tolist()), "frame 1.*end in 0 0 0 1"),
    "pose homogeneous": (set_pose([*POSE[:3], [0, 0, 0, 2]]), "frame 1.*end in 0 0 0 1"),
    "pose overflow": (set_pose([[10**400, 0, 0, 0], *POSE[1:]]), "transform_matrix"),
    "parent": (set_path("../secret.png"), "inside"),
    "a name too long for a file": (set_path("images/" + 256 * "x"), "cannot be a file's name"),
    "a path too long": (set_path(20 * (250 * "x" + "/") + "a.png"), "cannot be a file's name"),
    "half a letter": (set_path("images/\ud800.png"), "cannot be a file's name"),
    "hidden parent": (set_path("images/../../secret.png"), "inside"),
    "absolute": (set_path("/etc/passwd"), "inside"),
    "drive": (set_path("C:\\a.png"), "inside"),
    "nul": (set_path("images/a\0.png"), "inside"),
    "path type": (set_path(3), "file_path"),
    "path empty": (set_path(""), "inside"),
    "no path": (lambda d: d["frames"][1].pop("file_path"), "file_path"),
    "twice": (set_path("images/000.png"), "twice"),
    "split type": (lambda d: d.update(test_filenames=3), "test_filenames"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_fields_are_named_in_one_line(tmp_path, name):
    change, expected = BAD[name]
    document = copy.deepcopy(write_transforms(tmp_path, 3))
    change(document)
    save_json(tmp_path, document)
    with pytest.raises(DataError, match=expected) as caught:
        read_photo_set(tmp_path)
    assert "\n" not in str(caught.value)
    assert "transforms.json" in str(caught.value) or name == "aspect"


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", "3", '{"frames": [NaN]}', "[" * 100_000, '{"frames": "é', "\xff"]
)
def test_no_json_is_one_line(tmp_path, text):
    (tmp_path / "transforms.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError, match=r"transforms\.json"):
        read_photo_set(tmp_path)


def test_nan_in_a_pose(tmp_path):
    write_transforms(tmp_path, 2)
    file = tmp_path / "transforms.json"
    file.write_text(file.read_text().replace("1.5", "1e999", 1))
    with pytest.raises(DataError, match="transform_matrix"):
        read_photo_set(tmp_path)


def test_no_image_at_all(tmp_path):
    write_transforms(tmp_path, 2)
    for path in (tmp_path / "images").iterdir():
        path.unlink()
    with pytest.raises(DataError, match="none of the 2 listed photos"):
        read_photo_set(tmp_path)


def test_link_out_of_the_folder(tmp_path):
    root = tmp_path / "data"
    write_transforms(root, 2)
    outside = tmp_path / "outside.png"
    Image.fromarray(noise_image(40, 30)).save(outside)
    (root / "images" / "000.png").unlink()
    (root / "images" / "000.png").symlink_to(outside)
    with pytest.raises(DataError, match="link"):
        read_photo_set(root)
