"""Structure from motion: a ray-cast room, real photos, input that cannot work."""

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from clgs.cli.main import explain, main
from clgs.data.dataset import load_dataset
from clgs.errors import DataError, ExistsError, OutputError
from clgs.poses.prepare import prepare
from clgs.poses.verdict import GOOD, verdict_of
from clgs.poses.workspace import STAGES
from tests.data.folders import noise_image, orientation, write_noise, write_room_photos

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")


@pytest.mark.slow
def test_room_is_reconstructed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    photos, output = tmp_path / "photos", tmp_path / "data"
    poses = write_room_photos(photos, 9)
    turned = Image.open(photos / "4.png").transpose(Image.Transpose.ROTATE_180)
    turned.save(photos / "4.png", exif=orientation(3))
    assert main(["prepare", str(photos), "-o", str(output)]) == 0
    printed = capsys.readouterr()
    for stage in ("read", "features", "poses", "undistort"):
        assert f"\n{stage} 9/9" in "\n" + printed.err
    line = printed.out.splitlines()
    assert "registered 9 of 9 photos" in line[0]
    assert line[1].startswith("sure: a second reconstruction")
    assert line[2:] == [str(output / "report.html")]
    made = ["contact_sheet.jpg", "images", "report.html", "report.json", "sparse"]
    assert sorted(path.name for path in output.iterdir()) == made
    verdict = verdict_of(json.loads((output / "report.json").read_text()))
    assert {photo.status for photo in verdict.photos} == {GOOD}
    assert (verdict.registered, verdict.checked, verdict.ambiguous) == (9, True, False)
    data = load_dataset(output)
    assert (len(data.train), len(data.test), data.skipped) == (7, 2, 0)
    views = sorted(data.train + data.test, key=lambda view: view.name)
    centres = np.array([view.camera.centre for view in views])
    true = np.array([pose[:3, 3] for pose in poses])
    centres, true = centres - centres.mean(axis=0), true - true.mean(axis=0)
    centres = Rotation.align_vectors(true, centres)[0].apply(centres)
    centres *= (true * centres).sum() / (centres**2).sum()
    error = np.linalg.norm(centres - true, axis=1).max()
    assert error <= 0.02 * np.linalg.norm(true, axis=1).max()
    assert data.train[0].camera.fx == pytest.approx(320.0, rel=0.03)
    with pytest.raises(OutputError, match="not an empty folder"):
        prepare(photos, output)


@pytest.mark.slow
def test_photos_are_written_at_the_width_that_is_asked_for(tmp_path: Path):
    """Poses and points stay; a lens and the pixels of a mask follow."""
    photos = tmp_path / "photos"
    write_room_photos(photos, 5)
    (photos / "masks").mkdir()
    used = np.full((240, 320), 255, np.uint8)
    used[:80, :120] = 0
    Image.fromarray(used).save(photos / "masks" / "3.png")
    for name, size in (("whole", 0), ("small", 160)):
        prepare(photos, tmp_path / name, quick=True, max_size=size)
    whole, small = (load_dataset(tmp_path / name) for name in ("whole", "small"))
    assert np.array_equal(whole.points, small.points)
    for one, other in zip(whole.train, small.train, strict=True):
        assert other.camera.width == 160 < one.camera.width
        assert other.camera.fx == pytest.approx(one.camera.fx / 2, rel=0.01)
        assert np.array_equal(one.camera.rotation, other.camera.rotation)
    (mask,) = (view.used() for view in small.train + small.test if view.mask)
    assert not mask[:38, :57].any()
    assert mask[44:, 64:].all()


@pytest.fixture
def unrelated(tmp_path: Path) -> Path:
    """A folder of three photos that have nothing in common."""
    return write_noise(tmp_path / "photos", 3, (64, 48))


@pytest.mark.slow
def test_unrelated_photos_leave_nothing(unrelated: Path, tmp_path: Path):
    stages: list[str] = []
    with pytest.raises(DataError, match="overlapping"):
        prepare(unrelated, tmp_path / "data", on_progress=lambda stage, *_: stages.append(stage))
    first = [stage for stage in STAGES[:7] if stage != "all features"]
    assert list(dict.fromkeys(stages)) == first
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


@pytest.mark.slow
def test_a_thing_that_turns_before_a_camera_that_stands_is_named(tmp_path: Path):
    photos = tmp_path / "photos"
    photos.mkdir()
    for number in range(3):
        picture = noise_image(256, 192, 7)
        picture[60:120, 90:150] = noise_image(60, 60, number)
        Image.fromarray(picture).save(photos / f"{number}.png")
    with pytest.raises(DataError, match=r"100% of what they share stands still .* mask all else"):
        prepare(photos, tmp_path / "data", quick=True)


def test_a_full_disk_is_no_fault_of_a_photo(
    unrelated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    full = OSError(28, "No space left on device", str(unrelated / "0.png"))
    monkeypatch.setattr("clgs.poses.prepare.shutil.copyfile", Mock(side_effect=full))
    with pytest.raises(OSError, match="No space left") as caught:
        prepare(unrelated, tmp_path / "data")
    assert caught.value.filename == str(tmp_path / "data")
    assert explain(caught.value)[1] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


def test_only_results_of_the_same_command_are_overwritten(unrelated: Path, tmp_path: Path):
    photos = unrelated.rename(tmp_path / "images")
    with pytest.raises(ExistsError, match="was not made by clgs prepare"):
        prepare(photos, photos, overwrite=True)
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    (tmp_path / "sparse" / "0" / "cameras.bin").touch()
    with pytest.raises(ExistsError, match="holds the photos that are read"):
        prepare(tmp_path, tmp_path, overwrite=True)
    assert len(list(photos.iterdir())) == 3
    data = tmp_path / "data"
    (data / "sparse" / "0").mkdir(parents=True)
    (data / "sparse" / "0" / "cameras.bin").touch()
    (data / "run").mkdir()
    with pytest.raises(ExistsError, match="run: was not made by clgs prepare; move it"):
        prepare(photos, data, overwrite=True)
    assert (data / "run").is_dir()


def test_bad_folders(tmp_path: Path):
    with pytest.raises(DataError, match="no such file or folder"):
        prepare(tmp_path / "none", tmp_path / "data")
    (tmp_path / "file").touch()
    write_noise(tmp_path)
    with pytest.raises(OutputError, match="file: is no folder; choose another name"):
        prepare(tmp_path, tmp_path / "file" / "data")
    for number in range(3):
        (tmp_path / f"{number}.png").unlink()
    with pytest.raises(DataError, match="at least 3"):
        prepare(tmp_path, tmp_path / "data")
    for number in range(3):
        (tmp_path / f"{number}.jpg").write_bytes(b"no image %d" % number)
    with pytest.raises(DataError, match=r"0\.jpg"):
        prepare(tmp_path, tmp_path / "data")
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits(tmp_path: Path):
    photos = tmp_path / "photos"
    write_room_photos(photos, 5)
    (photos / "3.png").rename(photos / "3 a.png")
    made = []
    for folder in (tmp_path / "first", tmp_path / "second"):
        prepare(photos, folder, seed=5)
        files = sorted((folder / "sparse" / "0").iterdir()) + sorted((folder / "images").iterdir())
        made.append([(path.name, path.read_bytes()) for path in files])
    assert made[0] == made[1]


@pytest.mark.slow
def test_real_photos_register_completely(shared_data: Path, tmp_path: Path):
    source = shared_data / "sceaux_castle" / "images"
    if not source.is_dir():
        pytest.skip(f"no shared data: {source} is missing")
    (tmp_path / "few").mkdir()
    for photo in sorted(source.iterdir())[:6]:
        with Image.open(photo) as whole:
            whole.thumbnail((800, 800))
            whole.save(tmp_path / "few" / photo.name, quality=95, exif=whole.info.get("exif", b""))
    summary = prepare(tmp_path / "few", tmp_path / "data")
    assert (summary.registered, summary.total) == (6, 6)
    assert {photo.status for photo in summary.photos} == {GOOD}
    assert summary.points >= 2000
    assert summary.error <= 1.0


@pytest.mark.release
def test_sceaux_castle_registers_completely(shared_data: Path, tmp_path: Path):
    source = shared_data / "sceaux_castle"
    if not source.is_dir():
        pytest.skip(f"no shared data: {source} is missing")
    summary = prepare(source, tmp_path / "data")
    assert (summary.registered, summary.total) == (11, 11)
    assert {photo.status for photo in summary.photos} == {GOOD}
    assert summary.points >= 4000
    assert summary.error <= 1.0
