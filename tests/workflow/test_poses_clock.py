"""A run plans again, at once, if its photos take another time than their number and size tell."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from clgs.workflow.events import Note, StageProgress, StageRecord
from clgs.workflow.runs.clocks import PosesClock
from clgs.workflow.runs.plan import Photos, PosesTime, StepSpeed, TrainingPlan, poses_time
from clgs.workflow.runs.run import CORES, _Planner

PLANNED = PosesTime(features=20.0, matches=10.0, other=30.0)


def news(features: float, matches: float, first: int = 0) -> list[tuple[float, float]]:
    """What a clock says if these stages of 100 parts take this many seconds, from a part on."""
    now, said, passed = 0.0, list[tuple[float, float]](), list[object]()
    clock = PosesClock(PLANNED, lambda *one: said.append(one), passed.append, clock=lambda: now)
    for stage, seconds in (("read", 5.0), ("features", features), ("matches", matches)):
        for done in range(first, 101):
            clock(StageProgress(stage, done, 100))
            now += seconds / 100
    assert len(passed) == 3 * (101 - first)
    return said


def test_what_was_planned_is_no_news():
    assert news(20.0, 10.0) == []
    assert news(24.0, 12.5) == []
    assert news(16.0, 8.0) == []


@pytest.mark.parametrize("first", [0, 40])
def test_a_slower_machine_is_said_once(first):
    assert news(40.0, 20.0, first) == [(pytest.approx(60.0), pytest.approx(120.0))]
    assert news(10.0, 5.0, first) == [(pytest.approx(60.0), pytest.approx(30.0))]


def test_slow_matches_are_said_after_fast_features():
    first, second = news(10.0, 60.0)
    assert first == (pytest.approx(60.0), pytest.approx(30.0))
    assert second == (pytest.approx(30.0), pytest.approx(70.0 + 30.0 * 70 / 30))


def test_training_is_planned_again_and_shown_at_once():
    stages = SimpleNamespace(
        timed=lambda name: nullcontext(), measure_speed=lambda photos, data: StepSpeed(0.02, 1e-7)
    )
    events: list[object] = []
    photos = Photos(100, 1600, 1200)
    planner = _Planner(stages, events.append, 900.0, None, None, None)
    said = poses_time(photos, CORES, False)
    planned = planner.plan_training(photos, said.seconds, None)
    clock = planner.follow(photos, False)
    clock(StageProgress("features", 0, 1000))
    clock(StageProgress("features", 40, 1000))  # at once
    note, record = events[-2:]
    assert isinstance(note, Note)
    assert "instead of" in note.text
    assert isinstance(record, StageRecord)
    assert isinstance(record.record, TrainingPlan)
    assert record.record.steps > planned.steps or record.record.max_size > planned.max_size
