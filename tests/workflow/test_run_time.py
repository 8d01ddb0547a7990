"""What `clgs run` does if the time was too short: it says so, and goes on with more."""

from __future__ import annotations

import json
import os
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.cli.options import duration
from clgs.workflow.runs import clocks, stages
from clgs.workflow.runs.plan import FRAMES, LEAST_SHARE, Photos, StepSpeed, frames_within
from clgs.workflow.runs.run import _Planner
from tests.data.folders import write_video
from tests.small_scene import write_scene


def once(function):
    """``function``, but calls after the first return what that one did."""
    found = []

    def call(*arguments):
        if not found:
            found.append(function(*arguments))
        return found[0]

    return call


def planner_of(on_event, allowed):
    """A planner of ``allowed`` seconds on a device of one speed."""
    stages = SimpleNamespace(
        timed=lambda name: nullcontext(), measure_speed=lambda photos, data: StepSpeed(0.02, 1e-7)
    )
    return _Planner(stages, on_event, allowed, None, None, None)


@pytest.mark.slow
def test_plan_takes_as_many_frames_of_a_video_as_the_time_allows(tmp_path, monkeypatch, capsys):
    clip = write_video(tmp_path / "clip.mp4", [np.zeros((64, 96, 3), np.uint8)], fps=10)
    monkeypatch.setattr(stages, "synthetic_speed", once(clocks.synthetic_speed))
    for allowed in ("1m", "2h"):
        words = ["run", str(clip), "-o", str(tmp_path / "out"), "--plan", "--time", allowed]
        assert cli.main(words) == 0
        frames = frames_within(Photos(0, 96, 64), os.cpu_count() or 1, duration(allowed))
        assert f"frames, {frames} of 96 x 64 pixels" in capsys.readouterr().out
    assert frames == FRAMES[0]


@pytest.mark.slow
def test_a_sketch_goes_on_from_its_poses_with_more_time(tmp_path, monkeypatch, capsys, output_of):
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 4000)  # for speed
    data, out = write_scene(tmp_path / "data", train=6, test=2), tmp_path / "out"
    words = ["run", str(data), "-o", str(out), "--lambda=0.03", "--clip", "none"]
    said = " ".join(output_of(*words, "--steps", "30").split())
    assert "A sketch: 30 steps. More time makes it sharp: clgs run" in said
    assert "--resume --time" in (out / "report.html").read_text()
    first = json.loads((out / "plan.json").read_text())
    assert cli.main([*words, "--resume", "--time", "7m", "--steps", "40"]) == 0
    assert "the poses are kept" in capsys.readouterr().err
    record = json.loads((out / "plan.json").read_text())
    assert (first["settings"]["steps"], record["settings"]["steps"]) == (30, 40)
    assert (record["time"], record["digest"]) == (420.0, first["digest"])
    assert json.loads((out / "run" / "results.json").read_text())["steps"] == 40


def test_training_gets_its_share_however_long_the_poses_take(tmp_path):
    notes: list[str] = []
    planner = planner_of(lambda note: notes.append(note.text), 600.0)
    photos = Photos(50, 1600, 1200)
    free = planner.plan_training(photos, 0.0, tmp_path)
    assert not notes
    planner.start -= 900.0  # the poses took longer than all was to take
    late = planner.plan_training(photos, 0.0, tmp_path)
    assert 0.8 * LEAST_SHARE * 600 < late.seconds < 1.1 * LEAST_SHARE * 600
    assert late.max_size < free.max_size
    (note,) = notes
    assert "15.0 min of 10.0 min are spent" in note
