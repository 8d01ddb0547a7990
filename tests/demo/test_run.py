import math

import pytest
import run

from clgs.errors import DataError


@pytest.mark.parametrize(
    ("registered", "psnr", "count"),
    [(48, 25.0, 0), (46, 25.0, 0), (45, 25.0, 1), (48, 24.99, 1), (0, math.nan, 2)],
)
def test_what_falls_short_is_counted(registered, psnr, count):
    assert len(run.misses(registered, 48, psnr)) == count


def test_output_of_an_earlier_demo_is_cleared(tmp_path):
    out = tmp_path / "out"
    run.prepare_output(out, None)
    for name in ("scene", "photos"):
        (out / name).mkdir()
        (out / name / "file").touch()
    (out / "comparison.png").touch()
    (out / "notes.txt").touch()
    run.prepare_output(out, None)
    assert sorted(path.name for path in out.iterdir()) == [run.MARKER, "notes.txt"]


def test_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "data").mkdir()
    with pytest.raises(DataError, match="choose another --output"):
        run.prepare_output(tmp_path, None)
    (tmp_path / "data" / "file").touch()
    with pytest.raises(DataError, match="not a demo's output"):
        run.prepare_output(tmp_path / "data" / "file", None)
    assert (tmp_path / "data" / "file").exists()


def test_photos_inside_the_output_survive(tmp_path):
    run.prepare_output(tmp_path, None)
    for name in ("photos", "scene"):
        (tmp_path / name).mkdir()
    run.prepare_output(tmp_path, tmp_path / "photos")
    assert (tmp_path / "photos").is_dir()
    (tmp_path / "scene").mkdir()
    with pytest.raises(DataError, match="lies in the folder that the demo writes to"):
        run.prepare_output(tmp_path, tmp_path / "scene")
    assert (tmp_path / "scene").is_dir()


def test_what_falls_short_is_named():
    assert run.misses(40, 48, 20.0) == [
        "40 of 48 photos found their pose, 95% are needed",
        "held-out PSNR 20.00 dB, below 25 dB",
    ]


def test_demo_is_clgs_run_of_its_photos(monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(run, "clgs", lambda words: seen.append(words) or 3)
    monkeypatch.setattr(run, "choose_device", lambda name: "a device")
    (tmp_path / "photos").mkdir()
    out = tmp_path / "out"
    assert run.main([str(tmp_path / "photos"), "--output", str(out), "--steps", "7"]) == 3
    (words,) = seen
    assert words[:4] == ["run", str(tmp_path / "photos"), "-o", str(out / "scene")]
    assert words[words.index("--steps") + 1] == "7"
