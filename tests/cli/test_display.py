"""What is shown while work goes on."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from clgs.cli.commands.train import show
from clgs.cli.display import PLAIN_SECONDS, Display, describe
from clgs.train.run.run_folder import RunResult
from clgs.train.run.session import Progress
from clgs.train.run.trainer import StepResult
from clgs.workflow.events import Note, StageProgress, TrainingProgress, counter
from clgs.workflow.train import TrainedRun

RESULT = StepResult(12_345, "view", 0.1, 0.1, 0.9, None, 125_000)
TRAINING = TrainingProgress(Progress(RESULT, psnr=31.25, estimated_bytes=12_340_000), 30_000)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize("width", [80, 120])
def test_nothing_is_cut_on_a_terminal_of_80_columns(monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("FORCE_COLOR", "1")
    clock = Clock()
    with Display(clock) as display:
        display(TrainingProgress(Progress(RESULT), 30_000))
        clock.now = 0.1  # seconds: about 10 steps each
        display(TRAINING)
        shown = io.StringIO()
        Console(file=shown, width=width).print(display._bar.make_tasks_table(display._bar.tasks))
        assert display._bar is not None
    assert display._bar is None
    lines = shown.getvalue().rstrip().splitlines()
    assert len(lines) == 1
    for part in ("12345/30000", "it/s", ":", "31.25 dB  125,000 anchors  ~12.34 MB"):
        assert part in lines[0]


def test_without_a_terminal_long_work_prints_a_line_now_and_then(capsys):
    clock = Clock()
    with Display(clock) as display:
        display(Note("one view is missing"))
        advance = counter("features", 4, display)
        for clock.now in (4.0, PLAIN_SECONDS + 2, PLAIN_SECONDS + 4, 30.0):
            advance()
        display(StageProgress("short", 0, 1))
        display(StageProgress("short", 1, 1))
        display(StageProgress("short", 1, 1))
        clock.now = 60.0
        display(TRAINING)
        clock.now = 75.0
        display(replace(TRAINING, progress=Progress(replace(RESULT, step=12_346))))
    assert capsys.readouterr().err.splitlines() == [
        "clgs: one view is missing",
        "features 2/4, 12 s, about 12 s left",
        "features 4/4, 30 s",
        "short 1/1",
        "training 12346/30000, 15 s, about 264810 s left  0.1 it/s  train 31.25 dB  "
        "125,000 anchors  ~12.34 MB",
    ]


def test_lines_give_counts_and_the_time_left():
    assert describe("matches", 300, 1225, 60.0) == "matches 300/1225, 60 s, about 185 s left"
    assert describe("matches", 300, 1225, 60.0, 200) == "matches 300/1225, 60 s, about 555 s left"
    assert describe("matches", 0, 1225, 0.0) == "matches 0/1225"
    assert describe("matches", 1225, 1225, 240.0) == "matches 1225/1225, 240 s"
    assert describe("undistort", 0, 0, 0.0) == "undistort"


@pytest.mark.parametrize(("target", "said"), [(None, ""), (100_000, ""), (120_000, "16.7 %")])
def test_a_file_far_below_the_size_asked_for_is_named(tmp_path, capsys, target, said):
    summary = {"split": "test", "psnr": 30.0, "ssim": 0.9, "bytes": 100_000, "anchors": 5}
    summary |= {"train_seconds": 1.0} | ({"target_size": target} if target else {})
    show(TrainedRun(RunResult(tmp_path, None, b"", summary), 100))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + bool(said)
    assert said in lines[1]
