from __future__ import annotations

import math
from pathlib import Path

import pytest
import run
from outcome import Outcome

from clgs.errors import DataError

SCORES = {
    "protocol": "clgs-1", "psnr": 26.5, "ssim": 0.9, "views": 6, "bytes": 1000, "anchors": 10,
    "device": "a device", "background": [0, 0, 0], "per_view": [],
}  # fmt: skip


def outcome(registered=48, **scores):
    return Outcome(Path(), 48, registered, SCORES | scores)


@pytest.mark.parametrize(
    ("registered", "psnr", "misses"),
    [(48, 25.0, 0), (46, 25.0, 0), (45, 25.0, 1), (48, 24.99, 1), (0, math.nan, 2)],
)
def test_target_counts_what_falls_short(registered, psnr, misses):
    found = run.OWN_TARGET.misses(outcome(registered, psnr=psnr))
    assert len(found) == misses


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


def test_short_of_its_target_the_demo_fails(tmp_path, capsys):
    assert run.judge(outcome()) == 0
    assert run.judge(outcome(40, psnr=20.0)) == 1
    printed = capsys.readouterr().err
    assert "40 of 48 photos found their pose, 95% are needed" in printed
    assert "held-out PSNR 20.00 dB, below 25 dB" in printed


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
