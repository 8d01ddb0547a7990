"""COLMAP models written by pycolmap, whole and damaged."""

import contextlib
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from clgs.data.colmap_files import read_binary, read_text
from clgs.data.colmap_model import find_model, read_colmap, read_model
from clgs.data.colmap_records import PARAMETERS
from clgs.data.posed_photo import PhotoSet
from clgs.errors import DataError
from tests.data.folders import ring, write_colmap

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")


def load(root: Path) -> PhotoSet:
    return read_colmap(root, find_model(root))


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("rigs", [True, False])
@pytest.mark.parametrize("shared", [True, False])
def test_forms_of_a_model(tmp_path, text, rigs, shared):
    write_colmap(tmp_path, text=text, rigs=rigs, shared=shared)
    photos = load(tmp_path)
    assert [p.name for p in photos.test] == ["001.png", "009.png"]
    assert len(photos.train) == 8
    assert photos.train[0].centre == pytest.approx(ring(10)[1][:3, 3])
    assert (photos.train[0].lens.width, photos.train[0].lens.cx) == (41, 20.5)
    assert photos.points.shape == (20, 3)
    assert photos.point_colors[0].tolist() == [10, 20, 30]


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "RADIAL", "OPENCV", "FULL_OPENCV"])
def test_camera_models(tmp_path, model):
    write_colmap(tmp_path, model=model)
    lens = load(tmp_path).train[0].lens
    assert lens.fx == pytest.approx(50.0)
    assert lens.distorted == (model != "SIMPLE_PINHOLE")


def test_model_without_undistortion_here(tmp_path):
    write_colmap(tmp_path, model="THIN_PRISM_FISHEYE")
    with pytest.raises(DataError, match="image_undistorter"):
        load(tmp_path)


@pytest.mark.parametrize("text", [False, True])
def test_pycolmap_is_not_needed(tmp_path, monkeypatch, text):
    write_colmap(tmp_path, text=text)
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    assert len(load(tmp_path).train) == 8


def test_missing_images_are_counted_before_the_split(tmp_path):
    write_colmap(tmp_path)
    (tmp_path / "images" / "001.png").unlink()
    photos = load(tmp_path)
    assert photos.missing == ["001.png"]
    assert [p.name for p in photos.test] == ["002.png", "010.png"]


def test_sparse_without_number_and_missing_file(tmp_path):
    write_colmap(tmp_path)
    for file in (tmp_path / "sparse" / "0").iterdir():
        file.rename(tmp_path / "sparse" / file.name)
    assert len(load(tmp_path).train) == 8
    (tmp_path / "sparse" / "points3D.bin").unlink()
    with pytest.raises(DataError, match=r"points3D\.bin"):
        load(tmp_path)


def patch(path: Path, at: int, data: bytes) -> None:
    content = bytearray(path.read_bytes())
    content[at : at + len(data)] = data
    path.write_bytes(content)


NAN = struct.pack("<d", float("nan"))
IMAGE_NAME = 8 + 4 + 56 + 4
DAMAGE = {
    "huge width": ("cameras", 16, struct.pack("<Q", 2**63)),
    "zero width": ("cameras", 16, struct.pack("<Q", 0)),
    "NaN focal": ("cameras", 32, NAN),
    "negative focal": ("cameras", 32, struct.pack("<d", -1.0)),
    "unknown model": ("cameras", 12, struct.pack("<i", 99)),
    "camera count": ("cameras", 0, struct.pack("<Q", 2**60)),
    "image twice": ("images", 8, struct.pack("<I", 2)),
    "image of no camera": ("images", 68, struct.pack("<I", 99)),
    "point twice": ("points3D", 8, struct.pack("<Q", 2)),
    "NaN pose": ("images", 12, NAN),
    "zero quaternion": ("images", 12, bytes(32)),
    "parent name": ("images", IMAGE_NAME, b"../../a"),
    "absolute name": ("images", IMAGE_NAME, b"/etc/aa"),
    "not UTF-8": ("images", IMAGE_NAME, b"\xff\xfe"),
    "no terminator": ("images", IMAGE_NAME, b"a" * 1200),
    "image count": ("images", 0, struct.pack("<Q", 2**40)),
    "observations": ("images", IMAGE_NAME + 8, struct.pack("<Q", 2**40)),
    "point count": ("points3D", 0, struct.pack("<Q", 2**32)),
    "NaN point": ("points3D", 16, NAN),
    "track length": ("points3D", 8 + 8 + 24 + 3 + 8, struct.pack("<Q", 2**40)),
    "frame NaN": ("frames", 16, NAN),
    "frame zero quaternion": ("frames", 16, bytes(32)),
    "scaled quaternion": ("images", 12, struct.pack("<4d", 2.0, 0.0, 0.0, 0.0)),
    "infinite translation": ("images", 44, struct.pack("<d", float("inf"))),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_found(tmp_path, name):
    write_colmap(tmp_path)
    file, at, data = DAMAGE[name]
    patch(tmp_path / "sparse" / "0" / f"{file}.bin", at, data)
    with pytest.raises(DataError, match=rf"{file}\.bin") as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "rigs", "frames"])
def test_truncations_are_found(tmp_path, name):
    write_colmap(tmp_path)
    file = tmp_path / "sparse" / "0" / f"{name}.bin"
    whole = file.read_bytes()
    # Every length near the front, where all kinds of fields are, and a sample of the rest.
    for length in [*range(min(200, len(whole))), *range(200, len(whole), 7), len(whole) - 1]:
        file.write_bytes(whole[:length])
        with pytest.raises(DataError, match=rf"{name}\.bin"):
            read_binary(file.parent)


@pytest.mark.slow
def test_bit_flips_are_refused_or_harmless(tmp_path, rng):
    """A damaged model is refused with a DataError, or has finite poses and points."""
    write_colmap(tmp_path)
    for name in ("cameras", "images", "points3D", "rigs", "frames"):
        file = tmp_path / "sparse" / "0" / f"{name}.bin"
        whole = file.read_bytes()
        for bit in rng.choice(8 * len(whole), 20, replace=False).tolist():
            damaged = bytearray(whole)
            damaged[bit // 8] ^= 1 << bit % 8
            file.write_bytes(damaged)
            photos = None
            with contextlib.suppress(DataError):
                photos = read_colmap(tmp_path, file.parent)
            if photos is not None:
                assert np.isfinite([p.centre for p in photos.train + photos.test]).all()
                assert np.isfinite(photos.points).all()
        file.write_bytes(whole)


IMAGE = "1 1 0 0 0 0 0 0 1 001.png\n"
NO_TURN = "QW, QX, QY, QZ are not of length 1"


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("cameras", "1 PINHOLE x\n", "line 1: WIDTH is 'x', not a whole number"),
        ("cameras", "# a comment\n\n1 PINHOLE 41\n", "line 3: HEIGHT is missing"),
        ("cameras", "1 NOSUCH 41 31 1 2 3 4\n", "line 1: MODEL 'NOSUCH' is unknown"),
        ("cameras", "1 PINHOLE 41 31 50 50 20\n", "line 1: PARAMS are 3 numbers, PINHOLE has 4"),
        ("cameras", "1 PINHOLE 41 31 50 nan 20 9\n", "line 1: PARAMS is 'nan', not a finite"),
        ("cameras", f"1 PINHOLE {'9' * 20} 31 50 50 20 9\n", "line 1: WIDTH is '9"),
        ("cameras", 2 * "1 PINHOLE 41 31 50 50 20 9\n", "line 2: CAMERA_ID 1 occurs twice"),
        ("cameras", "1 PINHOLE 0 31 50 50 20 9\n", "line 1: camera size 0x31 is impossible"),
        ("cameras", "1 PINHOLE 41 31 50 -1 20 9\n", "line 1: focal length is not positive"),
        ("images", 2 * f"{IMAGE}\n", "line 3: IMAGE_ID 1 occurs twice"),
        ("images", IMAGE.replace("001", "../a"), "line 1: image name '../a.png' must stay inside"),
        ("images", IMAGE.replace("001.png", ""), "line 1: NAME is missing"),
        ("images", IMAGE.replace("1 1 0", "1 ? 0"), "line 1: QW is '?', not a finite number"),
        ("images", IMAGE.replace("1 0 0 0 0", "0 0 0 0 0"), f"line 1: {NO_TURN}"),
        ("images", f"\n{IMAGE.replace('1 1 0', '1 2 0')}", f"line 2: {NO_TURN}"),
        ("images", IMAGE.replace("1 1 0", "1 nan 0"), "line 1: QW is 'nan', not a finite number"),
        ("images", IMAGE.replace("0 1 001", "inf 1 001"), "line 1: TZ is 'inf', not a finite"),
        ("images", IMAGE.replace("0 1 001", "1e13 1 001"), "line 1: TX, TY, TZ are larger"),
        ("images", "1 1 0 0\n", "line 1: QZ is missing"),
        (
            "images",
            IMAGE.replace("1 1 0", "\u0661 1 0"),
            "line 1: IMAGE_ID is '\u0661', not a whole number",
        ),
        (
            "images",
            IMAGE.replace("1 1 0", "1 \u0661 0"),
            "line 1: QW is '\u0661', not a finite number",
        ),
        ("images", IMAGE.replace("1 1 0", "1 1 0_0"), "line 1: QX is '0_0', not a finite number"),
        ("images", f"{IMAGE}1 2\n", "line 2: POINTS2D are not of three numbers each"),
        (
            "images",
            f"{IMAGE}{IMAGE}",
            "line 2: POINTS2D are not of three numbers each; the line of",
        ),
        ("images", f"{IMAGE}1 2 3 0 0 0 0 0 1 1 b 001.png\n", "line 2: POINT3D_ID is '001.png'"),
        ("images", f"{IMAGE}1 2 x\n", "line 2: POINT3D_ID is 'x', not a whole number"),
        ("points3D", "7 2\n", "line 1: Y is missing"),
        ("points3D", "7 2 3 nan 1 2 3 0.1\n", "line 1: Z is 'nan', not a finite number"),
        ("points3D", 2 * "7 2 3 4 1 2 3 0.1\n", "line 2: point 7 occurs twice"),
        ("points3D", "7 2 3 4 300 2 3 0.1\n", "line 1: R is 300, not 0 to 255"),
        ("points3D", "7 2 3 4 1 2 3 0.1 99 0\n", "line 1: TRACK: images.txt has no point 0 of"),
        ("points3D", "7 2 3 4 1 2 3 0.1 1 99\n", "line 1: TRACK: images.txt has no point 99 of"),
    ],
)
def test_damaged_text_is_one_line_with_file_and_field(tmp_path, name, text, fault):
    write_colmap(tmp_path, text=True, rigs=False)
    file = tmp_path / "sparse" / "0" / f"{name}.txt"
    file.write_text(text)
    with pytest.raises(DataError) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{file}: {fault}")
    assert str(caught.value).endswith("export the model again")


FRAME = "1 1 1 0 0 0 0 0 4 1 CAMERA 1 1\n"
RIG = "1 3 CAMERA 1 CAMERA 2 0 CAMERA 3 1 1 0 0 0 0.1 0 0\n"


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("frames", FRAME.replace("1 1 1", "1 1 0"), f"line 1: {NO_TURN}"),
        ("frames", FRAME.replace("0 4 1", "0 nan 1"), "line 1: TZ is 'nan', not a finite number"),
        ("rigs", RIG.replace("1 1 0", "1 0 0"), f"line 1: {NO_TURN}"),
        ("rigs", RIG.replace("0.1", "inf"), "line 1: TX is 'inf', not a finite number"),
        ("rigs", RIG.removesuffix(" 0\n"), "line 1: TZ is missing"),
    ],
)
def test_poses_of_rigs_in_text_are_checked(tmp_path, name, text, fault):
    write_colmap(tmp_path, text=True)
    folder = tmp_path / "sparse" / "0"
    (folder / "frames.txt").write_text(FRAME)
    (folder / "rigs.txt").write_text(RIG)
    read_text(folder)
    (folder / f"{name}.txt").write_text(text)
    with pytest.raises(DataError) as caught:
        read_text(folder)
    assert str(caught.value).startswith(f"{folder / name}.txt: {fault}")


def test_a_name_with_a_blank_is_read_from_binary_models_alone(tmp_path):
    for text in (False, True):
        root = tmp_path / str(text)
        write_colmap(root, text=text, rigs=False)
        name = "images.txt" if text else "images.bin"
        file = root / "sparse" / "0" / name
        file.write_bytes(file.read_bytes().replace(b"002.png", b"0 2.png"))
        (root / "images" / "002.png").rename(root / "images" / "0 2.png")
    assert load(tmp_path / "False").test[0].name == "0 2.png"
    with pytest.raises(DataError, match=r"NAME '0 2\.png' has a blank.*as \.bin, or rename"):
        load(tmp_path / "True")


def test_other_blanks_and_a_mark_of_the_encoding_are_read(tmp_path):
    """COLMAP cuts names at blanks of ASCII; editors of Windows begin a text with U+FEFF."""
    write_colmap(tmp_path, text=True, rigs=False)
    name = "0\u30002.png"
    (tmp_path / "images" / "002.png").rename(tmp_path / "images" / name)
    for file in (tmp_path / "sparse" / "0").glob("*.txt"):
        text = file.read_text(encoding="utf-8").replace("002.png", name)
        file.write_text(text, encoding="utf-8-sig")
    photos = load(tmp_path)
    assert name in [photo.name for photo in (*photos.train, *photos.test)]


@pytest.mark.parametrize("text", [False, True])
def test_a_photo_with_two_poses_is_refused(tmp_path, text):
    write_colmap(tmp_path, text=text)
    file = tmp_path / "sparse" / "0" / f"images.{'txt' if text else 'bin'}"
    file.write_bytes(file.read_bytes().replace(b"002.png", b"001.png"))
    said = r"sparse.0.images\.\w+: image '001\.png': '001\.png' is listed twice; keep one"
    with pytest.raises(DataError, match=said):
        load(tmp_path)


def test_tracks_of_images_without_observations_are_not_checked(tmp_path):
    """Some programs write tracks, but no line of POINTS2D has a number."""
    write_colmap(tmp_path, text=True, rigs=False)
    folder = tmp_path / "sparse" / "0"
    poses = [x for x in (folder / "images.txt").read_text().splitlines() if x.endswith(".png")]
    (folder / "images.txt").write_text("".join(f"{pose}\n\n" for pose in poses))
    (folder / "points3D.txt").write_text("7 2 3 4 1 2 3 0.1 1 99 2 98\n")
    assert load(tmp_path).points.tolist() == [[2, 3, 4]]


@pytest.mark.parametrize("content", ["", "# nothing\n"])
def test_a_model_without_images_is_one_line(tmp_path, content):
    write_colmap(tmp_path, text=True, rigs=False)
    (tmp_path / "sparse" / "0" / "images.txt").write_text(content)
    with pytest.raises(DataError, match=r"lists no photos; export the poses again$") as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


def test_images_of_no_camera_are_named(tmp_path):
    write_colmap(tmp_path, text=True, rigs=False)
    (tmp_path / "sparse" / "0" / "cameras.txt").write_text("")
    with pytest.raises(DataError, match=r"images\.txt: line \d+: CAMERA_ID 1 is not in cameras\.t"):
        load(tmp_path)


def test_names_and_numbers_of_camera_models_are_those_of_pycolmap():
    import pycolmap

    for number, (name, parameters) in enumerate(PARAMETERS.items()):
        camera = pycolmap.Camera.create_from_model_name(1, name, 50.0, 41, 31)
        assert int(camera.model) == number
        assert len(camera.params) == len(parameters.split())


@pytest.mark.parametrize("name", ["fern_colmap_8", "can", "rig"])
def test_both_forms_hold_what_pycolmap_reads(tmp_path, request, name):
    import pycolmap

    if name == "rig":  # ten frames of two cameras, without points
        pycolmap.set_random_seed(0)
        options = pycolmap.SyntheticDatasetOptions(num_points3D=0)
        options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 2, 10
        known = pycolmap.synthesize_dataset(options)
    else:
        folder = request.getfixturevalue("shared_data") / name / "sparse" / "0"
        known = pycolmap.Reconstruction(str(folder))
    images = {image.name: image for image in known.images.values()}
    points = [point for _, point in sorted(known.points3D.items())]
    for text in (False, True):
        written = tmp_path / str(text)
        written.mkdir()
        (known.write_text if text else known.write_binary)(written)
        found = read_model(written)
        assert {image.name for image in found.images} == images.keys()
        for image in found.images:
            camera, pose = images[image.name].camera, images[image.name].cam_from_world().matrix()
            assert image.camera.model == camera.model_name
            assert image.camera.params == tuple(camera.params)
            assert (image.camera.width, image.camera.height) == (camera.width, camera.height)
            assert np.array_equal(image.rotation(), pose[:, :3])
            assert np.array_equal(image.translation, pose[:, 3])
        assert np.array_equal(found.position, np.reshape([p.xyz for p in points], (-1, 3)))
        assert np.array_equal(found.color, np.reshape([p.color for p in points], (-1, 3)))
