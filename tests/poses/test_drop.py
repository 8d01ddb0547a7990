"""Photos in doubt leave the data set, with their masks and what rests on them alone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.cli.main import main
from clgs.data.dataset import load_dataset
from clgs.errors import DataError
from clgs.poses.drop import drop_doubtful
from clgs.poses.reconstruct import reconstruct
from clgs.poses.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict, Verdict, verdict_of
from tests.data.folders import write_room_photos

PHOTOS = 7
DOUBTED = "3.png"


@pytest.mark.slow
def test_what_is_in_doubt_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    photos, output = tmp_path / "photos", tmp_path / "data"
    write_room_photos(photos, PHOTOS)
    (photos / "masks").mkdir()
    used = np.full((240, 320), 255, np.uint8)
    used[:40, :40] = 0
    Image.fromarray(used).save(photos / "masks" / DOUBTED)

    def reconstruct_and_doubt(*arguments) -> Verdict:
        verdict = reconstruct(*arguments)
        assert {photo.status for photo in verdict.photos} == {GOOD}
        doubted = tuple(
            replace(photo, status=DOUBTFUL, reasons=("a reason",), remedy="a remedy")
            if photo.name == DOUBTED
            else photo
            for photo in verdict.photos
        )
        return replace(verdict, photos=doubted)

    monkeypatch.setattr("clgs.poses.prepare.reconstruct", reconstruct_and_doubt)
    words = ["prepare", str(photos), "-o", str(output), "--drop-doubtful", "--quick"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "registered 6 of 7 photos" in lines[0]
    assert lines[1].endswith("; the 1 in doubt are left out")
    assert lines[2] == f"  {DOUBTED}: left out: a reason; a remedy"
    names = [f"{number}.png" for number in range(PHOTOS) if number != 3]
    assert sorted(path.name for path in (output / "images").iterdir()) == names
    assert not (output / "masks" / f"{DOUBTED}.png").exists()
    data = load_dataset(output)
    assert sorted(Path(view.name).name for view in data.train + data.test) == names
    verdict = verdict_of(json.loads((output / "report.json").read_text()))
    assert [photo.name for photo in verdict.of(LEFT_OUT)] == [DOUBTED]
    model = pycolmap.Reconstruction(output / "sparse" / "0")
    assert verdict.points == model.num_points3D() > 100
    assert verdict.error < 1.0
    tracks = [len(point.track.elements) for point in model.points3D.values()]
    assert min(tracks) >= 2
    assert verdict.track_length == pytest.approx(np.mean(tracks))
    assert (output / "report.html").is_file()


def test_too_few_good_photos_are_refused_and_nothing_changes(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for number in range(PHOTOS):
        (tmp_path / "images" / f"{number}.png").touch()
    figures = (7, PHOTOS, 1000, 4000, 0.5, 4.0, "incremental", {}, ())
    every = tuple(PhotoVerdict(f"{number}.png", GOOD) for number in range(PHOTOS))
    verdict = Verdict(*figures, every, True, False, 0.0, "sure")
    assert drop_doubtful(tmp_path, verdict) is verdict
    few = (*every[:2], *(replace(photo, status=DOUBTFUL) for photo in every[2:]))
    with pytest.raises(DataError, match="only 2 of 7 photos are not in doubt, 3 are needed"):
        drop_doubtful(tmp_path, replace(verdict, photos=few))
    assert len(list((tmp_path / "images").iterdir())) == PHOTOS
