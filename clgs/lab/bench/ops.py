"""`clgs bench ops`: time and error of every stage, and what the device can do at most."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from clgs.lab.bench.stage_limits import (
    FORMULAS,
    Counts,
    DeviceLimits,
    Share,
    count_work,
    measure_limits,
    share_of_limit,
)
from clgs.lab.bench.step import synthetic_trainer, time_steps
from clgs.lab.devices import open_devices
from clgs.lab.facts import machine_facts, show_table, write_figures
from clgs.lab.selftest.reference_render import Check
from clgs.lab.selftest.render_checks import selftest
from clgs.lab.selftest.training_checks import training_checks
from clgs.opencl.device import Device
from clgs.workflow.outputs import check_new

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
"""The workload on emulators."""


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


def run(
    gaussians: int | None,
    size: int | None,
    elements: int | None,
    repeats: int | None,
    seed: int | None,
    device: str | None,
    json: Path | None,
    overwrite: bool,
) -> int:
    """Measure, print and, if asked, write JSON; exit code 1 if an error exceeds its limit."""
    if json:
        check_new(json, overwrite)
    sizes = {"gaussians": gaussians, "size": size, "elements": elements}
    sizes |= {"repeats": repeats, "seed": seed}
    given = {name: value for name, value in sizes.items() if value is not None}
    records, passed = [], True
    for _, opened in open_devices(device):
        load = replace(TINY if opened.is_emulator else Workload(), **given)
        figures = bench_ops(opened, load)
        passed &= figures.passed
        records.append(machine_facts(opened) | {"workload": asdict(load), **asdict(figures)})
        show(opened, figures)
    formulas = {name: formula.text() for name, formula in FORMULAS.items()}
    write_figures(json, {"formulas": formulas, "devices": records})
    return 0 if passed else 1


def bench_ops(device: Device, load: Workload) -> OpsFigures:
    """Check every stage on the self-test's scene, then time it on a scene of the given size."""
    checks = list(selftest(device))
    limits = measure_limits(device)
    trainer = synthetic_trainer(device, load.gaussians, load.size, load.seed)
    times = dict(time_steps(trainer, load.repeats).stages)
    counts = count_work(device, trainer.render_next(), trainer.parameters.scene, load.elements)
    for check in training_checks(device, load.elements):
        if check.stage in ALONE:
            times[check.stage] = check.milliseconds
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


def show(device: Device, figures: OpsFigures) -> None:
    """Print a row per stage."""
    limits, counts = figures.limits, figures.counts
    title = (
        f"{device.name} ({device.specialisation}): copies {limits.bytes_per_second / 1e9:.1f} GB/s,"
        f" {limits.flops_per_second / 1e9:.0f} GFLOP/s; {counts.A:,} anchors, {counts.N:,} "
        f"Gaussians, {counts.I:,} intersections, {counts.B:,} blended pairs, {counts.P:,} pixels"
    )
    rows = []
    for stage in figures.stages:
        error, rates = ["", ""], ["", "", ""]
        if check := stage.check:
            error = [f"{check.error:.1e}", f"{check.limit:.0e}{'' if check.passed else ' FAIL'}"]
        if share := stage.share:
            rates = [
                f"{share.gigabytes_per_second:.1f}",
                f"{share.gigaflops:.1f}",
                f"{100 * share.of_limit:.0f} % {share.bound}",
            ]
        rows.append((stage.stage, f"{stage.milliseconds:.2f}", *error, *rates))
    head = ("stage", "ms", "error", "limit", "GB/s", "GFLOP/s", "of limit")
    show_table(title, head, rows)
