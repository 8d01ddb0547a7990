"""The speed that the plan of `clgs run` rests on."""

from __future__ import annotations

import pytest

from clgs.opencl.device import Device
from clgs.workflow.events import ignore
from clgs.workflow.runs import clocks
from clgs.workflow.runs.plan import Photos, StepSpeed
from tests.data.folders import write_blender

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
