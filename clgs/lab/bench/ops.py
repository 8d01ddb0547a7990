"""Time and error of every stage, beside what the device can do at most."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.lab.bench.device_limits import DeviceLimits, measure_limits
from clgs.lab.bench.stage_work import Counts, Share, count_work, share_of_limit
from clgs.lab.bench.step import synthetic_trainer, time_steps
from clgs.lab.selftest.render_checks import Check, selftest
from clgs.lab.selftest.training_checks import training_checks
from clgs.opencl.device import Device

ALONE = ("scan", "sort", "quantize", "rate")
"""Stages that a training step does not time by themselves: timed on ``elements`` numbers."""


@dataclass(frozen=True)
class Workload:
    """What to time: sizes, repeats, and the seed of the scene.

    gaussians: neural Gaussians drawn; size: pixels of the image's edge; elements: numbers for the
    stages timed alone; repeats: runs to take the median of.
    """

    gaussians: int = 200_000
    size: int = 400
    elements: int = 1_000_000
    repeats: int = 15
    seed: int = 0


TINY = Workload(gaussians=70, size=24, elements=600, repeats=1)
"""For emulators."""


@dataclass(frozen=True)
class StageFigures:
    """One stage: median milliseconds, its worst check, its share of the device's limit if known."""

    stage: str
    milliseconds: float
    check: Check | None
    share: Share | None


@dataclass(frozen=True)
class OpsFigures:
    """All stages of one device, what they worked on, and the device's limits."""

    limits: DeviceLimits
    counts: Counts
    stages: list[StageFigures]

    @property
    def passed(self) -> bool:
        """Whether every error is within its limit."""
        return all(stage.check is None or stage.check.passed for stage in self.stages)


def bench_ops(device: Device, load: Workload) -> OpsFigures:
    """Check every stage on the self-test's scene, then time it on a scene of the given size."""
    checks = list(selftest(device))
    limits = measure_limits(device)
    trainer = synthetic_trainer(device, load.gaussians, load.size, load.seed)
    times = dict(time_steps(trainer, load.repeats).stages)
    counts = count_work(device, trainer.render_next(), trainer.parameters.scene, load.elements)
    for stage, _, _, _, milliseconds in training_checks(device, load.elements):
        if stage in ALONE:
            times[stage] = milliseconds
    stages = [
        StageFigures(
            name,
            milliseconds,
            worst_check(name, checks),
            share_of_limit(name, counts, milliseconds, limits),
        )
        for name, milliseconds in times.items()
    ]
    return OpsFigures(limits, counts, stages)


def worst_check(stage: str, checks: list[Check]) -> Check | None:
    """The check of a stage that is nearest to its limit; the backward kernels share theirs."""
    name = stage.split(" ")[0]
    if stage.endswith("backward") and name != "loss":
        name = "backward"
    own = [check for check in checks if check.stage == name]
    failed = [check for check in own if not check.passed]
    return failed[0] if failed else max(own, key=lambda check: check.share, default=None)
