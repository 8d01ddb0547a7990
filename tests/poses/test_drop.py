"""Photos in doubt leave the data set, with their masks and what rests on them alone."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.cli.commands import prepare as command
from clgs.data.dataset import load_dataset
from clgs.errors import DataError
from clgs.poses import drop
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT, verdict_of
from clgs.poses.prepare import prepare
from tests.data.folders import room_image, room_poses

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

PHOTOS = 7


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a room; a corner of the fourth is masked."""
    folder = tmp_path_factory.mktemp("drop") / "photos"
    (folder / "masks").mkdir(parents=True)
    for number, pose in enumerate(room_poses(PHOTOS)):
        image = Image.fromarray(room_image(pose, (320, 240), 320.0))
        image.save(folder / f"{number}.png")
    used = np.full((240, 320), 255, np.uint8)
    used[:40, :40] = 0
    Image.fromarray(used).save(folder / "masks" / "3.png")
    return folder


def test_what_is_in_doubt_is_left_out(
    photos: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def training(data: Path, on_step: object) -> dict[str, float]:
        shown = {f"{number}.png": 0.02 for number in range(PHOTOS)}
        assert sorted(path.name for path in (data / "images").iterdir()) == sorted(shown)
        return shown | {"3.png": 0.9}

    monkeypatch.setattr(command, "_short_training", training)
    parser = argparse.ArgumentParser()
    command.register(parser)
    output = tmp_path / "data"
    args = parser.parse_args([str(photos), "-o", str(output), "--drop-doubtful"])
    assert command.run(args) == 0
    told = capsys.readouterr().out.splitlines()
    assert "registered 6 of 7 photos" in told[0]
    assert told[1].endswith("; the 1 in doubt are left out")
    assert told[2].startswith("  3.png: left out: a short training shows the other photos")
    names = [f"{number}.png" for number in range(PHOTOS) if number != 3]
    assert sorted(path.name for path in (output / "images").iterdir()) == names
    assert not (output / "masks" / "3.png.png").exists()
    data = load_dataset(output)
    assert sorted(Path(view.name).name for view in data.train + data.test) == names
    verdict = verdict_of(json.loads((output / "report.json").read_text()))
    assert [photo.name for photo in verdict.of(LEFT_OUT)] == ["3.png"]
    model = pycolmap.Reconstruction(output / "sparse" / "0")
    assert verdict.points == model.num_points3D() > 100
    assert verdict.error < 1.0
    tracks = [len(point.track.elements) for point in model.points3D.values()]
    assert min(tracks) >= 2
    assert verdict.track_length == pytest.approx(np.mean(tracks))
    assert (output / "report.html").is_file()


def test_too_few_good_photos_are_refused_and_leave_nothing(photos: Path, tmp_path: Path) -> None:
    verdict = prepare(photos, tmp_path / "all", quick=True)
    none = replace(verdict, photos=tuple(replace(p, status=GOOD) for p in verdict.photos))
    assert drop.drop_doubtful(tmp_path / "all", none) is none
    few = tuple(
        replace(photo, status=GOOD if number < 2 else DOUBTFUL)
        for number, photo in enumerate(verdict.photos)
    )
    with pytest.raises(DataError, match="only 2 of 7 photos are not in doubt, 3 are needed"):
        drop.drop_doubtful(tmp_path / "all", replace(verdict, photos=few))
    assert len(list((tmp_path / "all" / "images").iterdir())) == PHOTOS
