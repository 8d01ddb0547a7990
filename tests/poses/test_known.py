"""Poses that are given: refined, refuted, completed; data sets that grow; GPS tags."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial.transform import Rotation

from clgs.cli.main import explain
from clgs.data.dataset import load_dataset, read_photo_set
from clgs.errors import DataError
from clgs.poses.evidence import Poses
from clgs.poses.find import find_photos
from clgs.poses.gps import GPS, fit, read_place, read_positions
from clgs.poses.known import read_known
from clgs.poses.prepare import prepare
from clgs.poses.verdict import GOOD
from clgs.scene.world import EARTH, axes_at, geocentric, place_of
from tests.data.folders import opengl, save_json, write_noise, write_room, write_room_photos
from tests.data.programs.captures import Capture, metashape_xml

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

BERN = (46.948, 7.447, 540.0)


def write_known(root: Path, count: int, pose: Callable[[np.ndarray], list[list[float]]]):
    """Photos of a room in ``root``/images, and a transforms.json; returns the true poses."""
    poses = write_room(root, count)
    document = json.loads((root / "transforms.json").read_text())
    for frame, one in zip(document["frames"], poses, strict=True):
        frame["transform_matrix"] = pose(one)
    save_json(root, document | {"w": 320, "h": 240})
    return poses


def centres_of(folder: Path) -> np.ndarray:
    found = read_photo_set(folder)
    return np.array([p.centre for p in sorted(found.train + found.test, key=lambda p: p.name)])


def distances(centres: np.ndarray) -> np.ndarray:
    return np.linalg.norm(centres[:, None] - centres, axis=2)


def scattered(pose: np.ndarray) -> list[list[float]]:
    """The right turn at a place that is none."""
    moved = pose.copy()
    moved[:3, 3] = np.random.default_rng(int(1e6 * abs(pose[0, 3]))).uniform(-1, 1, 3)
    return opengl(moved)


@pytest.mark.slow
def test_noisy_poses_are_refined_in_their_own_units(tmp_path: Path, capfd):
    rng = np.random.default_rng(0)

    def shaken(pose: np.ndarray) -> list[list[float]]:
        moved = pose.copy()
        moved[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(0.01 * rng.normal(size=3)).as_matrix()
        moved[:3, 3] += 0.02 * rng.normal(size=3)
        return opengl(moved)

    root = tmp_path / "capture"
    poses = write_known(root, 7, shaken)
    verdict = prepare(root / "images", tmp_path / "data", poses=root / "transforms.json")
    assert (verdict.registered, verdict.mapper) == (7, "given poses")
    assert capfd.readouterr().err == ""  # pycolmap's log
    assert {photo.status for photo in verdict.photos} == {GOOD}
    (note,) = verdict.notes
    assert "the world is that of its 7 poses" in note
    true = distances(np.array([pose[:3, 3] for pose in poses]))
    error = np.abs(distances(centres_of(tmp_path / "data")) - true)
    assert error.max() <= 0.05 * true.max()  # the scale is that of the given poses
    shaken_error = np.abs(distances(centres_of(root)) - true)
    assert error.mean() < shaken_error.mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (lambda pose: pose.tolist(), "OpenGL's axes of cameras are taken for OpenCV's"),
        (
            lambda pose: opengl(np.linalg.inv(pose)),
            "camera to world is taken for world to camera",
        ),
        (scattered, "contradict the directions between their cameras"),
    ],
)
def test_poses_in_the_wrong_convention_are_named_and_not_used(
    tmp_path: Path, pose: Callable[[np.ndarray], list[list[float]]], words: str
):
    root = tmp_path / "capture"
    write_known(root, 9, pose)
    verdict = prepare(root / "images", tmp_path / "data", quick=True, poses=root)
    assert (verdict.registered, verdict.mapper) == (9, "incremental")
    (note,) = verdict.notes
    assert "its poses are not used" in note
    assert words in note


@pytest.mark.slow
def test_a_data_set_grows(tmp_path: Path):
    """The old photos keep their world; a photo that is there already is not added twice."""
    write_room_photos(tmp_path / "all", 7)
    (tmp_path / "few").mkdir()
    for number in range(5):
        shutil.copy(tmp_path / "all" / f"{number}.png", tmp_path / "few")
    prepare(tmp_path / "few", tmp_path / "old", quick=True)
    (tmp_path / "more").mkdir()
    for number in range(5, 7):
        shutil.copy(tmp_path / "all" / f"{number}.png", tmp_path / "more")
    old = tmp_path / "old"
    verdict = prepare(tmp_path / "more", tmp_path / "new", continued=old)
    assert (verdict.registered, verdict.total, verdict.mapper) == (7, 7, "given poses")
    before, after = centres_of(old), centres_of(tmp_path / "new")[:5]
    assert np.abs(after - before).max() <= 0.02 * distances(before).max()
    (tmp_path / "more" / "below").mkdir()
    (tmp_path / "more" / "5.png").rename(tmp_path / "more" / "below" / "0.png")
    for again in ("few", "more"):  # in a folder, too, it would be taken for the old one
        with pytest.raises(DataError, match="has a photo of this name"):
            prepare(tmp_path / again, tmp_path / "twice", continued=old)
    (tmp_path / "one").mkdir()
    shutil.copy(tmp_path / "all" / "6.png", tmp_path / "one")
    assert prepare(tmp_path / "one", tmp_path / "six", quick=True, continued=old).registered == 6


@pytest.mark.slow
def test_a_data_set_grows_between_its_photos(tmp_path: Path):
    """Each old photo matches a new one better than any other old one."""
    write_room_photos(tmp_path / "old", 9)
    (tmp_path / "new").mkdir()
    for number in range(1, 9, 2):
        (tmp_path / "old" / f"{number}.png").rename(tmp_path / "new" / f"{number}.png")
    prepare(tmp_path / "old", tmp_path / "data", quick=True)
    verdict = prepare(tmp_path / "new", tmp_path / "all", quick=True, continued=tmp_path / "data")
    assert (verdict.registered, verdict.mapper) == (9, "given poses")


def test_poses_of_other_photos_are_refused_in_a_line(tmp_path: Path):
    write_known(tmp_path / "capture", 4, opengl)
    photos = write_noise(tmp_path / "others", 4)
    for number, photo in enumerate(sorted(photos.iterdir())):
        photo.rename(photos / f"other{number}.png")
    with pytest.raises(DataError, match="none of its 4 photos is in") as caught:
        prepare(photos, tmp_path / "data", poses=tmp_path / "capture")
    assert "\n" not in explain(caught.value)
    assert not (tmp_path / "data").exists()


def test_a_file_of_cameras_needs_no_photos_next_to_it(tmp_path: Path, caplog):
    capture = Capture(tmp_path / "capture")
    capture.photos(tmp_path / "photos")
    (tmp_path / "photos" / capture.names[2]).unlink()
    given = tmp_path / "cameras"
    given.mkdir()
    (given / "right.xml").write_text(metashape_xml(capture))
    (given / "a_wrong.xml").write_text("<document/>")
    known = read_known(given / "right.xml", find_photos(tmp_path / "photos"))
    assert len(known.photos) == len(capture.names) - 1
    (line,) = caplog.messages
    assert f"photos lacks 1 of its photos: {Path(capture.names[2]).stem}" in line
    with pytest.raises(DataError, match=r"none\.xml: no such file or folder"):
        read_known(given / "none.xml", find_photos(tmp_path / "photos"))
    with pytest.raises(DataError, match=r"a_wrong\.xml"):
        read_known(given / "a_wrong.xml", find_photos(tmp_path / "photos"))


def tag(path: Path, place: tuple[float, float, float], without: tuple[int, ...] = ()) -> None:
    """Save a photo again as JPEG with a GPS tag, which lacks the parts ``without``."""
    exif = Image.Exif()

    def parts(degrees: float) -> tuple[IFDRational, ...]:
        whole = int(abs(degrees))
        rest = (abs(degrees) - whole) * 3600
        return IFDRational(whole), IFDRational(0), IFDRational(round(rest * 1_000_000), 1_000_000)

    latitude, longitude, altitude = place
    exif.get_ifd(GPS).update(
        {
            1: "N" if latitude >= 0 else "S",
            2: parts(latitude),
            3: "E" if longitude >= 0 else "W",
            4: parts(longitude),
            5: bytes([altitude < 0]),
            6: IFDRational(round(abs(altitude) * 1000), 1000),
        }
    )
    for part in without:
        exif.get_ifd(GPS).pop(part)
    Image.open(path).save(path.with_suffix(".jpg"), exif=exif, quality=95)
    path.unlink()


@pytest.mark.parametrize("place", [BERN, (-33.9, -70.1, -12.5)])
def test_gps_tags_are_read(tmp_path: Path, place: tuple[float, float, float]):
    photo = tmp_path / "0.png"
    Image.new("RGB", (8, 6)).save(photo)
    assert read_place(photo) is None
    tag(photo, place)
    assert read_place(photo.with_suffix(".jpg")) == pytest.approx(place, abs=1e-8)
    assert place_of(geocentric(place)) == pytest.approx(place, abs=1e-8)


def test_a_tag_without_altitude_gets_that_of_the_others(tmp_path: Path):
    photos = [tmp_path / f"{number}.png" for number in range(3)]
    for photo, without in zip(photos, ((), (5, 6), ()), strict=True):
        Image.new("RGB", (8, 6)).save(photo)
        tag(photo, BERN, without)
    positions, origin, notes = read_positions(tmp_path.glob("*.jpg"))
    assert origin == pytest.approx(BERN, abs=1e-8)
    assert np.abs(list(positions.values())).max() < 1e-3
    assert notes == [f"GPS tags of 1 of 3 photos have no altitude; {BERN[2]:g} m is assumed"]


class LevelWalk:
    """A workspace of photos that walk around a house, and the tags that they have."""

    def __init__(self, mirrored: bool) -> None:
        angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        centre = 10 * np.stack([np.cos(angle), np.sin(angle), 0.01 * np.sin(5 * angle)], 1)
        self.names = [f"{number}.jpg" for number in range(16)]
        tags = centre * np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
        self.positions = dict(zip(self.names, tags, strict=True))
        self.pycolmap, self.seed = pytest.importorskip("pycolmap"), 0
        away = centre * [1, 1, 0]
        forward = -away / np.linalg.norm(away, axis=1, keepdims=True)
        down = np.broadcast_to([0.0, 0.0, -1.0], forward.shape)
        rotation = np.stack([np.cross(down, forward), down, forward], 1)
        self.poses = Poses(self.names, rotation, centre / 3, np.ones(16))


def test_mirrored_gps_tags_are_refused():
    """A level walk fits tags of America without W, too, turned upside down."""
    for mirrored in (False, True):
        walk = LevelWalk(mirrored)
        found, notes = fit(walk, walk.poses)
        assert (found is None) == mirrored
        assert len(notes) == 1
        assert ("the tags are mirrored" in notes[0]) == mirrored


@pytest.mark.slow
def test_gps_tags_give_scale_and_place_and_a_lie_is_named(tmp_path: Path):
    """The camera's path, 30 times as large, near Bern; one tag is a kilometre off."""
    photos, output = tmp_path / "photos", tmp_path / "data"
    poses = write_room_photos(photos, 9)
    metres = 30.0 * np.array([pose[:3, 3] for pose in poses])
    metres[4, 1] += 1000.0
    for number, one in enumerate(metres):
        tag(photos / f"{number}.png", place_of(geocentric(BERN) + axes_at(BERN).T @ one))
    verdict = prepare(photos, output, quick=True)
    fitted, lie = verdict.notes
    assert fitted.startswith("GPS tags give scale and place")
    assert lie.startswith("GPS tags contradict the poses of 4.jpg by 1000 m")
    assert read_photo_set(output).frame == EARTH
    assert load_dataset(output).transform.frame == EARTH
    true = 30.0 * distances(np.array([pose[:3, 3] for pose in poses]))
    assert np.abs(distances(centres_of(output)) - true).max() <= 0.05 * true.max()
