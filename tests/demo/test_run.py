from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import run
from outcome import Outcome, Target, box_rows, make_report, print_box, read_curve, section_bytes
from PIL import Image

from clgs.errors import DataError
from clgs.export.report import report_html

SCORES = {
    "protocol": "clgs-1", "psnr": 26.5, "ssim": 0.9, "views": 6, "bytes": 1000, "anchors": 10,
    "device": "a device", "background": [0, 0, 0], "per_view": [],
}  # fmt: skip


def outcome(registered=48, **scores):
    sections = {"positions": 300, "rest": 700}
    return Outcome(48, registered, SCORES | scores, sections, {"train": 100.0, "eval": 2.5}, [])


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
    for name in ("data", "photos"):
        (out / name).mkdir()
        (out / name / "file").touch()
    (out / "scene.clgs").touch()
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
    for name in ("photos", "data"):
        (tmp_path / name).mkdir()
    run.prepare_output(tmp_path, tmp_path / "photos")
    assert (tmp_path / "photos").is_dir()
    (tmp_path / "data").mkdir()
    with pytest.raises(DataError, match="lies in the folder that the demo writes to"):
        run.prepare_output(tmp_path, tmp_path / "data")
    assert (tmp_path / "data").is_dir()


def test_survey_counts_photos_and_scales_large_ones(tmp_path):
    for index in range(3):
        Image.fromarray(np.zeros((30, 1900, 3), np.uint8)).save(tmp_path / f"{index}.JPG")
    (tmp_path / "notes.txt").touch()
    assert run.survey(tmp_path) == (3, 3)


def test_survey_of_no_photos_is_one_clear_line(tmp_path):
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DataError, match="no photos found"):
            run.survey(folder)
    (tmp_path / "broken.jpg").write_bytes(b"no photo")
    with pytest.raises(DataError, match=r"broken\.jpg: not a readable photo"):
        run.survey(tmp_path)


def test_failed_command_stops_with_its_exit_code(monkeypatch, tmp_path, capfd):
    monkeypatch.chdir(tmp_path)
    stages = run.Stages()
    with pytest.raises(SystemExit) as caught:
        stages.clgs("decode", "decode", tmp_path / "missing.clgs", "-o", tmp_path / "scene.npz")
    assert caught.value.code == 3
    assert "decode failed" in capfd.readouterr().err
    assert list(stages.seconds) == ["decode"]


def test_commands_run_in_this_python(monkeypatch):
    seen = []

    def fake(command, **options):
        seen.append((command, options))
        return run.subprocess.CompletedProcess(command, 0, "text", None)

    monkeypatch.setattr(run.subprocess, "run", fake)
    assert run.Stages().clgs("info", "info", "a b.clgs", quiet=True) == "text"
    command, options = seen[0]
    assert command == [sys.executable, "-P", "-m", "clgs.cli.main", "info", "a b.clgs"]
    assert "shell" not in options


def test_curve_leaves_out_events(tmp_path):
    path = tmp_path / "progress.csv"
    path.write_text("step,psnr,event\n0,10.5,\n50,11.0,before_switch\n100,,\n100,12.25,\n")
    assert read_curve(path) == [(0, 10.5), (100, 12.25)]


def test_sections_are_named_in_words_and_unknown_ones_kept():
    info = {"bytes": 100, "sections": {"container": 5, "OFFS": 60, "NEWS": 35}}
    assert section_bytes(info) == {"container": 5, "offsets": 60, "NEWS": 35}


def test_box_tells_all_numbers(tmp_path, capsys):
    text = " ".join(value for _, value in box_rows(outcome(), tmp_path))
    for part in ("48 of 48", "26.50 dB", "0.9000", "1,000", "102.5", "train 100.0", "report.html"):
        assert part in text
    print_box(outcome(), tmp_path, Target(0.95, 27.0))
    printed = capsys.readouterr().out
    assert "short of its target" in printed
    assert "below 27 dB" in printed


def test_page_holds_the_numbers():
    page = report_html(make_report(outcome()), [])
    parts = ("26.50 dB", "0.9000", "positions", "a device", "48 of 48", "800.0 bits per anchor")
    for part in parts:
        assert part in page
