"""Verdicts on poses: good photos count, those in doubt are shown apart; photos and truth agree."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from PIL import Image

from clgs.errors import DataError
from clgs.poses.verdict import DOUBTFUL, GOOD, PhotoVerdict, Verdict
from scripts.bench.poses import (
    QUARTER,
    apart,
    changed,
    copy_photos,
    read_poses,
    read_verdict,
    summary,
)
from tests.small_scene import write_scene

WIDTH, HEIGHT = 8, 4
TURNED = 20.0
"""Degrees of the one photo that is wrong."""


def prepared(folder, wrong=False):
    """A data set with the report of `clgs prepare`; ``wrong``: its first photo, as it says."""
    write_scene(folder, train=8, test=1)
    path = folder / "transforms.json"
    (folder / "transforms_train.json").rename(path)
    (folder / "transforms_test.json").unlink()
    document = json.loads(path.read_text())
    photos = []
    for number, frame in enumerate(document["frames"]):
        status = DOUBTFUL if wrong and number == 0 else GOOD
        photos.append(PhotoVerdict(frame["file_path"].rpartition("/")[2] + ".jpg", status))
        if status == DOUBTFUL:
            turn = np.radians(TURNED)
            about_z = np.eye(4)
            about_z[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
            frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ about_z).tolist()
    path.write_text(json.dumps(document))
    counts = {"incremental": 9}
    verdict = Verdict(
        8, 8, 90, 400, 0.5, 4.0, "incremental", counts, (), tuple(photos), True, False, 0.0,
        "mostly sure", {"features": 3.0, "pairs": 2.0},
    )  # fmt: skip
    (folder / "report.json").write_text(json.dumps(asdict(verdict)))
    return folder


def test_only_photos_that_are_good_in_both_count(tmp_path):
    first, second = prepared(tmp_path / "a"), prepared(tmp_path / "b", wrong=True)
    verdicts = read_verdict(first), read_verdict(second)
    names = [{photo.name.removesuffix(".jpg") for photo in one.of(GOOD)} for one in verdicts]
    good = names[0] & names[1]
    assert len(good) == 7
    said = apart(read_poses(first), read_poses(second), good)
    assert said.startswith("7 good ones of ")
    assert "differ by at most 0.000 degrees" in said
    assert f"(all: {TURNED:.3f})" in said
    assert apart(read_poses(first), read_poses(second), set()).startswith("none of ")


def test_names_that_photos_share_are_told(tmp_path):
    write_scene(tmp_path / "data", train=3, test=1)
    with pytest.raises(SystemExit, match="share names"):
        read_poses(tmp_path / "data")


def test_a_verdict_is_one_line(tmp_path):
    said = summary(read_verdict(prepared(tmp_path / "a", wrong=True)))
    assert said == "8 of 8 with a pose, 1 doubtful, 0 left out; 0.50 px, 5 s; mostly sure"


def test_a_folder_that_prepare_did_not_make_is_named(tmp_path):
    with pytest.raises(SystemExit, match=r"report.json: no report of `clgs prepare`"):
        read_verdict(tmp_path)
    with pytest.raises(DataError, match=str(tmp_path)):
        read_poses(tmp_path)


def test_a_photo_and_its_camera_are_turned_alike():
    pixels = np.zeros((HEIGHT, WIDTH), np.uint8)
    pixels[1, 6] = 255
    turned = np.asarray(changed(Image.fromarray(pixels), "turn", 1))
    (row,), (column,) = np.nonzero(turned)
    ray = np.array([6.5 - WIDTH / 2, 1.5 - HEIGHT / 2, 1.0])  # from the middle of the photo
    x, y, _ = QUARTER @ ray
    assert (column + 0.5, row + 0.5) == (x + HEIGHT / 2, y + WIDTH / 2)


def test_poses_are_those_of_the_photos_that_were_copied(tmp_path):
    data = write_scene(tmp_path / "data", train=6, test=2)
    (tmp_path / "chosen").mkdir()
    turned = copy_photos(data / "train", 2, "turn", tmp_path / "chosen")
    assert sorted(turned) == sorted(path.stem for path in (tmp_path / "chosen").iterdir())
    assert list(turned.values()) == [False, True, False]
    poses = read_poses(data, "train", turned)
    plain = read_poses(data, "train", dict.fromkeys(turned, False))
    assert poses.names == plain.names == sorted(turned)
    for name, rotation, before in zip(poses.names, poses.rotation, plain.rotation, strict=True):
        np.testing.assert_array_equal(rotation, (QUARTER if turned[name] else np.eye(3)) @ before)
