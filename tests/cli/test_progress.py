"""What is shown while a scene is trained."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from clgs.cli.progress import PLAIN_SECONDS, TrainingDisplay, _Lines, print_summary
from clgs.train.run.finished_run import RunResult
from clgs.train.run.session import Progress
from clgs.train.run.trainer import StepResult


@pytest.mark.parametrize("width", [80, 120])
def test_nothing_is_cut_on_a_terminal_of_80_columns(monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    display = TrainingDisplay(30_000, 0)
    display._start -= 1000  # seconds: about 12 steps each
    result = StepResult(12_345, "view", 0.1, 0.1, 0.9, None, 125_000)
    display.update(Progress(result, psnr=31.25, estimated_bytes=12_340_000))
    shown = io.StringIO()
    progress = display._progress
    Console(file=shown, width=width).print(progress.make_tasks_table(progress.tasks))
    lines = shown.getvalue().rstrip().splitlines()
    assert len(lines) == 1
    for part in ("12345/30000", "it/s", "-:--:--", "31.25 dB  125,000 anchors  ~12.34 MB"):
        assert part in lines[0]


def test_without_a_terminal_long_work_prints_a_line_now_and_then(capsys):
    seconds = iter([0.0, 5.0, PLAIN_SECONDS, PLAIN_SECONDS + 1.0])
    advance = _Lines("baking", 4, lambda: next(seconds))
    for _ in range(3):
        advance()
    assert capsys.readouterr().err == "baking 2/4, 15 s, about 15 s left\n"


@pytest.mark.parametrize(("target", "told"), [(None, ""), (100_000, ""), (120_000, "16.7 %")])
def test_a_file_far_below_the_size_asked_for_is_told(tmp_path, capsys, target, told):
    summary = {"split": "test", "psnr": 30.0, "ssim": 0.9, "bytes": 100_000, "anchors": 5}
    summary |= {"train_seconds": 1.0} | ({"target_size": target} if target else {})
    print_summary(RunResult(tmp_path, None, b"", summary))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + bool(told)
    assert told in lines[1]
