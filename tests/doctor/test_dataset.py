"""Every fault that a data set can have is named, with a remedy."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.cli.main import main
from clgs.doctor import ERROR, NOTE, WARNING
from clgs.doctor.dataset import examine
from clgs.errors import DataError
from tests.data.folders import (
    move_cameras,
    noise_image,
    opengl,
    orientation,
    ring,
    save_json,
    write_blender,
    write_colmap,
    write_transforms,
)


def levels(root: Path) -> dict[str, list[str]]:
    """Place and problem of each finding in one text, by level."""
    found = examine(root).findings
    assert all(one.remedy for one in found)
    return {
        level: [f"{one.where}: {one.problem}" for one in found if one.level == level]
        for level in (ERROR, WARNING, NOTE)
    }


def has(found: list[str], *parts: str) -> bool:
    return any(all(part in line for part in parts) for line in found)


@pytest.fixture
def healthy(tmp_path):
    write_transforms(tmp_path, 24, (80, 64))
    return tmp_path


def change(root: Path, frame: int, **fields) -> None:
    document = json.loads((root / "transforms.json").read_text())
    document["frames"][frame] |= fields
    save_json(root, document)


def test_a_healthy_set_has_no_findings(healthy, output_of):
    assert examine(healthy).findings == []
    out = output_of("doctor", healthy).splitlines()
    assert out == [
        f"{healthy}: transforms, 24 photos (21 to train on, 3 held out)",
        "nothing found",
    ]


@pytest.mark.parametrize("write", [write_blender, write_colmap])
def test_other_kinds_have_no_errors(tmp_path, write):
    if write is write_colmap:
        pytest.importorskip("pycolmap")
    write(tmp_path)
    assert levels(tmp_path)[ERROR] == []


def test_all_bad_frames_are_named_at_once(healthy, capsys):
    change(healthy, 1, file_path="../outside.png")
    change(healthy, 3, transform_matrix=[[1.0] * 4] * 4)
    change(healthy, 5, fl_x=float("nan"))
    nan = np.eye(4)
    nan[0, 3] = np.nan
    change(healthy, 6, transform_matrix=nan.tolist())
    change(healthy, 7, file_path="images/008.png")
    change(healthy, 9, file_path="images/none.png")
    (healthy / "images" / "010.png").write_bytes(b"no image")
    found = levels(healthy)
    assert has(found[ERROR], "frame 1:", "must stay inside")
    assert has(found[ERROR], "frame 3:", "not a rotation")
    assert has(found[ERROR], "frame 5:", "fl_x")
    assert has(found[ERROR], "frame 6:", "no finite position")
    assert has(found[ERROR], "frame 8:", "listed twice")
    assert has(found[ERROR], "010.png", "damaged") or has(found[ERROR], "010.png", "not a JPEG")
    assert has(found[WARNING], "images/none.png", "1 of 18 photos are missing")
    assert main(["doctor", str(healthy), "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert {"level", "where", "problem", "remedy"} == set(document["findings"][0])
    assert document["findings"][0]["level"] == ERROR


def test_missing_photos_with_other_capitals(healthy):
    (healthy / "images" / "004.png").rename(healthy / "images" / "004.PNG")
    change(healthy, 4, file_path="images/004.jpg")
    (warning,) = examine(healthy).findings
    assert "rename 004.PNG" in warning.remedy


def test_lenses(healthy):
    change(healthy, 1, k1=-0.05)
    change(healthy, 2, k1=-30.0)
    change(healthy, 3, cx=10.0)
    change(healthy, 4, fl_x=2000.0, fl_y=2000.0)
    change(healthy, 5, fl_x=50.0, fl_y=60.0)
    found = levels(healthy)
    assert has(found[NOTE], "001.png", "a distorted lens")
    assert has(found[ERROR] + found[WARNING], "002.png")
    assert has(found[WARNING], "003.png", "principal point (10.0, 32.0) of 80x64 is 38% off")
    assert has(found[WARNING], "004.png", "2.3 degrees across")
    assert has(found[WARNING], "005.png", "not square")


def test_copies_of_bits_and_of_poses(healthy):
    poses = ring(24)
    change(healthy, 2, transform_matrix=opengl(poses[3]))
    images = healthy / "images"
    (images / "005.png").write_bytes((images / "006.png").read_bytes())
    found = levels(healthy)
    assert found[WARNING] == [
        "images/002.png, images/003.png: 2 photos have one pose",
        "images/005.png, images/006.png: 2 files hold the same bytes",
    ]


def test_cameras_apart_tipped_or_turned_away(healthy):
    poses = ring(24)
    far = poses[2].copy()
    far[:3, 3] *= 20
    change(healthy, 2, transform_matrix=opengl(far))
    rolled = poses[7] @ np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    change(healthy, 7, transform_matrix=opengl(rolled))
    away = poses[9] @ np.diag([-1.0, 1.0, -1.0, 1.0])
    change(healthy, 9, transform_matrix=opengl(away))
    found = levels(healthy)[WARNING]
    assert has(found, "images/002.png: more than 5 times as far")
    assert has(found, "images/007.png: tipped")
    assert has(found, "images/009.png: looks away")
    assert len(found) == 3


def test_one_photo_is_an_error(tmp_path):
    write_transforms(tmp_path, 1, (80, 64))
    found = levels(tmp_path)
    assert found[ERROR] == [": one photo is too few to train on"]


def test_nothing_left_to_train_on_is_an_error(healthy):
    names = [f"images/{number:03d}.png" for number in range(24)]
    write_transforms(healthy, 24, (80, 64), test_filenames=names)
    assert has(levels(healthy)[ERROR], "all photos are held out, none is left to train on")


def test_a_fault_that_all_frames_share_is_said_once(healthy):
    write_transforms(healthy, 24, (80, 64), k1=None)
    (line,) = (line for line in levels(healthy)[ERROR] if "k1" in line)
    assert line.endswith("transforms.json: k1 is not a number")
    change(healthy, 3, k1=None)
    own = [line for line in levels(healthy)[ERROR] if "k1" in line]
    assert [line.rpartition("transforms.json")[2] for line in own] == [
        *(": k1 is not a number", ": frame 3: k1 is not a number")
    ]


def test_cameras_in_one_place(healthy):
    move_cameras(healthy / "transforms.json", lambda _: np.full(3, 0.5))
    assert has(levels(healthy)[WARNING], "all cameras are in one place")


def test_exposure_that_jumps(healthy):
    path = healthy / "images" / "011.png"
    Image.fromarray(noise_image(80, 64, 11) // 4).save(path)
    (line,) = levels(healthy)[WARNING]
    assert "010.png to images/011.png (2.0 stops)" in line
    assert "011.png to images/012.png (2.0 stops)" in line


@pytest.mark.parametrize(
    ("tag", "done"), [(3, "taken as stored"), (6, "turned to fit their poses")]
)
@pytest.mark.parametrize("of", ["photos", "masks"])
def test_exif_orientations_are_named(healthy, tag, done, of):
    photo, mask = Image.open(healthy / "images" / "001.png"), Image.new("L", (80, 64), 255)
    if of == "masks":
        change(healthy, 1, mask_path="mask.png")
    path, picture = (healthy / "mask.png", mask) if of == "masks" else (photo.filename, photo)
    picture = picture.rotate(90, expand=True) if tag == 6 else picture
    picture.save(path, exif=orientation(tag))
    (note,) = levels(healthy)[NOTE]
    assert note.startswith(f"images/001.png: 1 {of} have an EXIF orientation")
    assert note.endswith(done)


def test_masks_are_checked(healthy):
    (healthy / "masks").mkdir()
    half = np.zeros((64, 80), np.uint8)
    half[:32] = 255
    Image.fromarray(half).save(healthy / "masks" / "a.png")
    Image.fromarray(half[:5]).save(healthy / "masks" / "b.png")
    change(healthy, 1, mask_path="masks/a.png")
    assert levels(healthy)[NOTE] == [": 1 photos are masked; 50% of their pixels are used"]
    change(healthy, 2, mask_path="masks/b.png")
    change(healthy, 3, mask_path="masks/none.png")
    found = levels(healthy)[ERROR]
    assert has(found, "b.png", "80x5")
    assert has(found, "frame 3:", "mask_path")


def test_photos_alone_and_nothing_at_all(tmp_path, capsys):
    with pytest.raises(DataError, match="no such folder"):
        examine(tmp_path / "none")
    with pytest.raises(DataError, match="no transforms"):
        examine(tmp_path)
    Image.fromarray(noise_image(8, 8)).save(tmp_path / "a.png")
    (tmp_path / "notes.txt").touch()
    found = examine(tmp_path)
    assert found.summary.endswith("1 photos without poses")
    assert "clgs prepare" in found.findings[0].remedy
    assert found.findings[1].problem.startswith("skipped 1")
    assert main(["doctor", str(tmp_path)]) == 3
    assert "-> " in capsys.readouterr().out


def test_damaged_photos_alone_are_named_and_not_counted(tmp_path):
    for seed, name in enumerate("abc"):
        Image.fromarray(noise_image(64, 64, seed)).save(tmp_path / f"{name}.png")
    whole = (tmp_path / "b.png").read_bytes()
    (tmp_path / "b.png").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "d.jpg").write_bytes(b"no picture")
    found = examine(tmp_path)
    assert found.summary.endswith(": 2 photos without poses")
    errors = " ".join(one.problem for one in found.findings if one.level == ERROR)
    assert [name in errors for name in ("a.png", "b.png", "c.png", "d.jpg")] == [0, 1, 0, 1]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"frames": [1]}', '{"frames": "x"}', "{" * 9999])
def test_files_that_are_none(tmp_path, text):
    (tmp_path / "transforms.json").write_text(text)
    assert levels(tmp_path)[ERROR]


def test_a_damaged_colmap_model(tmp_path):
    pytest.importorskip("pycolmap")
    write_colmap(tmp_path)
    file = tmp_path / "sparse" / "0" / "images.bin"
    file.write_bytes(file.read_bytes()[:50])
    assert len(levels(tmp_path)[ERROR]) == 1


def test_a_damaged_file_of_points(healthy):
    write_transforms(healthy, 24, (80, 64), ply_file_path="points.ply")
    points = healthy / "points.ply"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    points.write_text("ply\nformat ascii 1.0\nelement vertex 9\n")
    assert has(levels(healthy)[ERROR], "points.ply", "is damaged")
    points.write_text(
        f"ply\nformat ascii 1.0\nelement vertex 3\n{axes}end_header\n0 0 0\n1 0 0\n0 1 0\n"
    )
    assert not levels(healthy)[ERROR]
    assert has(levels(healthy)[WARNING], "points.ply", "only 3 points to start from")
