"""The speed that the plan of `clgs run` rests on, and a new plan if photos take another time."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from clgs.opencl.device import Device
from clgs.ops.match import MAX_DESCRIPTORS
from clgs.poses.stages.features import find_features, opencv
from clgs.workflow.events import Note, StageProgress, StageRecord, ignore
from clgs.workflow.runs import clocks
from clgs.workflow.runs.clocks import PosesClock
from clgs.workflow.runs.plan import (
    PRODUCT_SECONDS,
    Photos,
    PosesTime,
    StepSpeed,
    TrainingPlan,
    poses_time,
)
from clgs.workflow.runs.run import CORES
from tests.data.folders import write_blender
from tests.workflow.test_run_time import planner_of

SLOW = StepSpeed(90.0, 1e-3)


@pytest.mark.parametrize(("start", "slow"), [(clocks.GROWN + 500, False), (200, True)])
def test_few_anchors_at_the_start_say_little_of_later_steps(tmp_path, monkeypatch, start, slow):
    write_blender(tmp_path / "data")
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", start)
    monkeypatch.setattr(clocks, "synthetic_speed", lambda device: SLOW)
    measured = clocks._step_seconds  # much, if other programs run
    monkeypatch.setattr(clocks, "_step_seconds", lambda *step: min(measured(*step), 0.004))
    photos = Photos(8, 40, 40, synthetic=True)
    data, run = tmp_path / "data", tmp_path / "run"
    found = clocks.speed_on(Device(), data, photos, run, 0, ignore)
    assert (found.fixed > 0.05) == slow
    assert found.step(1600) < SLOW.step(1600)


def test_between_never_shortens():
    assert clocks._between(0.01, 0.04) == pytest.approx(0.02)
    assert clocks._between(0.04, 0.01) == 0.04
    assert clocks._between(0.0, 1.0) == 0.0


def test_a_trial_finds_the_features_of_photos_that_can_be_read(tmp_path):
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (30, 40, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    files = [tmp_path / f"{name}.png" for name in ("textured", "blank", "broken")]
    Image.fromarray(coarse).save(files[0])
    Image.fromarray(np.zeros_like(coarse)).save(files[1])
    files[2].write_bytes(files[0].read_bytes()[:1000])
    cv2 = opencv("test")
    _, expected = find_features(cv2, files[0], None, 320, MAX_DESCRIPTORS)
    found = clocks.try_photos(Device(), files, 320)
    assert found.features == len(expected) / 2 > 50
    assert found.seconds > 0
    assert found.product == PRODUCT_SECONDS  # nothing to compare with
    both = clocks.try_photos(Device(), files[:1] * 2, 320)
    assert both.features == len(expected)
    assert both.product > 0
    assert clocks.try_photos(Device(), files[2:], 320) is None


PLANNED = PosesTime(features=20.0, matches=10.0, other=30.0)


def said_of(*steps: tuple[str, int, float]) -> list[tuple[float, float]]:
    """What a clock says of stages, their parts of 100 that are done, and seconds until the next."""
    now, said, passed = 0.0, list[tuple[float, float]](), list[object]()
    clock = PosesClock(PLANNED, lambda *one: said.append(one), passed.append, clock=lambda: now)
    for stage, done, seconds in steps:
        clock(StageProgress(stage, done, 100))
        now += seconds
    assert len(passed) == len(steps)
    return said


def news(features: float, matches: float, first: int = 0) -> list[tuple[float, float]]:
    """What a clock says if these stages of 100 parts take this many seconds, from a part on."""
    stages = ("read", 5.0), ("features", features), ("matches", matches)
    parts = range(first, 101)
    return said_of(*((stage, done, seconds / 100) for stage, seconds in stages for done in parts))


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


def test_pairs_that_show_nothing_do_not_count_as_matched():
    said = said_of(
        *(("features", 0, 10.0), ("features", 50, 10.0), ("features", 100, 0.0)),
        *(("looks", 0, 2.0), ("looks", 100, 0.0)),
        *(("matches", 60, 7.0), ("matches", 70, 0.0)),  # a quarter of those that are left
    )
    assert said == [(pytest.approx(60.0), pytest.approx(100.0))]  # 20 + 2 + 28, and as much again


def test_features_of_an_earlier_call_take_no_time_and_tell_nothing():
    matches = (("matches", done, 0.11) for done in range(101))
    assert said_of(("features", 100, 0.0), *matches) == []


def test_training_is_planned_again_and_shown_at_once():
    events: list[object] = []
    photos = Photos(100, 1600, 1200)
    planner = planner_of(events.append, 900.0)
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
