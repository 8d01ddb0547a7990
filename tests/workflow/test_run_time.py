"""What `clgs run` does if the time was too short: it says so, and goes on with more."""

from __future__ import annotations

import json
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from clgs.cli import main as cli
from clgs.workflow.runs.plan import LEAST_SHARE, Photos, StepSpeed
from clgs.workflow.runs.run import _Planner
from tests.small_scene import write_scene


@pytest.mark.slow
def test_a_sketch_goes_on_from_its_poses_with_more_time(tmp_path, capsys):
    data, out = write_scene(tmp_path / "data", train=6, test=2), tmp_path / "out"
    words = ["run", str(data), "-o", str(out), "--lambda=0.03", "--clip", "none"]
    assert cli.main([*words, "--steps", "30"]) == 0
    said = " ".join(capsys.readouterr().out.split())
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
    stages = SimpleNamespace(
        timed=lambda name: nullcontext(), measure_speed=lambda photos, data: StepSpeed(0.02, 1e-7)
    )
    notes: list[str] = []
    planner = _Planner(stages, lambda note: notes.append(note.text), 600.0, None, None, None)
    photos = Photos(50, 1600, 1200)
    free = planner.plan_training(photos, 0.0, tmp_path)
    assert not notes
    planner.start -= 900.0  # the poses took longer than all was to take
    late = planner.plan_training(photos, 0.0, tmp_path)
    assert 0.8 * LEAST_SHARE * 600 < late.seconds < 1.1 * LEAST_SHARE * 600
    assert late.max_size < free.max_size
    (note,) = notes
    assert "15.0 min of 10.0 min are spent" in note
