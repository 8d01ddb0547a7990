"""`clgs bench ops`: time and error of every stage, and what the device can do at most.

What a stage must do at least gives its share of the limit. Bytes: every input is read once and
every output written once, as if caches were perfect. Operations: those of the useful work only. An
FMA counts as two, an exponential by its polynomial, and a pair of pixel and Gaussian that
contributes nothing counts as none. Both are lower bounds, so the share is a lower bound, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from clgs.lab import kernels as limits
from clgs.lab.bench.step import synthetic_trainer, time_steps
from clgs.lab.commands import open_devices
from clgs.lab.figures import finished_times, machine_facts, show_table, write_figures
from clgs.lab.kernels import blend_decisions
from clgs.lab.selftest.reference_render import Check
from clgs.lab.selftest.render_checks import selftest
from clgs.lab.selftest.training_checks import training_checks
from clgs.opencl.device import Device
from clgs.render.frame import DeviceScene, Frame

COPY_BYTES = 128 << 20
"""Size of one array, well beyond the caches of today's processors."""
EMULATED_BYTES = 1 << 16
LEAST_SECONDS = 0.02
REPEATS = 7
GROUPS_PER_UNIT = {"cpu": 4, "gpu": 64}


@dataclass(frozen=True)
class DeviceLimits:
    """Measured rates of a device.

    A copied byte counts twice (read, written), a fused multiply-add as two operations.
    """

    bytes_per_second: float
    flops_per_second: float


def measure_limits(device: Device) -> DeviceLimits:
    """Measure a copy between two large arrays, and chains of FMAs in registers."""
    largest = EMULATED_BYTES if device.is_emulator else COPY_BYTES
    count: int = min(largest, device.cl_device.global_mem_size // 16) // 4
    source, target = device.zeros((count,)), device.zeros((count,))
    copying = _best_seconds(device, lambda: limits.copy(device, source, target))

    groups = 1 if device.is_emulator else device.cl_device.max_compute_units
    groups *= GROUPS_PER_UNIT[device.specialisation]
    steps = 16
    if not device.is_emulator:  # chains grow until they take LEAST_SECONDS
        while _best_seconds(device, partial(limits.fma, device, groups, steps), 2) < LEAST_SECONDS:
            steps *= 4
    lanes = len(limits.fma(device, groups, steps))
    computing = _best_seconds(device, partial(limits.fma, device, groups, steps))
    return DeviceLimits(8 * count / copying, 2 * limits.CHAINS * steps * lanes / computing)


def _best_seconds(device: Device, work: Callable[[], object], repeats: int = REPEATS) -> float:
    return min(finished_times(device, work, repeats)) / 1e3


@dataclass(frozen=True)
class Counts:
    """Sizes of one render, and of the stages that are timed by themselves.

    A anchors, V visible, N neural Gaussians, I entries of tile lists, B blended pairs of pixel and
    Gaussian, P pixels, M trained numbers; E elements given to the stages timed by themselves.
    """

    A: int
    V: int
    N: int
    I: int  # noqa: E741 - the letter of ARCHITECTURE.md
    B: int
    P: int
    M: int
    E: int


Terms = dict[str, int]
"""Factor of each letter of Counts."""


@dataclass(frozen=True)
class Formula:
    """Bytes and operations of a stage as sums of factors times counts."""

    bytes: Terms
    flops: Terms

    def evaluate(self, counts: Counts) -> tuple[int, int]:
        """Bytes and operations."""
        moved, made = (
            sum(factor * getattr(counts, letter) for letter, factor in terms.items())
            for terms in (self.bytes, self.flops)
        )
        return moved, made

    def text(self) -> str:
        """The formula for people: "64 I + 20 P B, 30 B flop"."""
        moved, made = (
            " + ".join(f"{factor:,} {letter}" for letter, factor in terms.items()) or "0"
            for terms in (self.bytes, self.flops)
        )
        return f"{moved} B, {made} flop"


FORMULAS: dict[str, Formula] = {
    # position, scaling in; an index out; a transform and a box
    "cull": Formula({"A": 36, "V": 4}, {"A": 40}),
    # 53 inputs in, twice; 110 rows out; 53 * 150 + 50 * 110 multiply-adds
    "mlp forward": Formula({"V": 4 * (53 + 53 + 110)}, {"V": 26_900}),
    # inputs, outputs and their gradients in, that of the feature out; twice the multiply-adds, and
    # those of the hidden layers again
    "mlp backward": Formula({"V": 4 * (53 + 110 + 110 + 50)}, {"V": 69_700}),
    # 110 outputs, offsets, scaling, position in; 14 floats and a slot out
    "neural forward": Formula({"V": 4 * (110 + 39), "N": 60}, {"N": 60}),
    # 14 gradients, outputs, offsets in; d_output, d_offset, d_scaling out
    "neural backward": Formula({"N": 60, "V": 4 * (220 + 39), "A": 4 * 36}, {"N": 150}),
    # 11 floats in, 8 out
    "project forward": Formula({"N": 76}, {"N": 200}),
    # 10 floats, 5 gradients and 5 of the projection in; 10 gradients out
    "project backward": Formula({"N": 120}, {"N": 500}),
    # 9 floats in; the Gaussian and the row of an entry out; one test of ellipse against tile
    "tiles": Formula({"N": 36, "I": 8}, {"I": 40}),
    # 9 floats per Gaussian, once per entry, in; colour, transmittance, contributor out
    "blend forward": Formula({"I": 36, "P": 20}, {"B": 36}),
    # the same in; a row of moments of 36 bytes out and in again; 9 gradients out
    "blend backward": Formula({"I": 36 + 72, "P": 20, "N": 36}, {"B": 72}),
    # picture and photo in; separable windows of 11 taps over 5 maps
    "loss forward": Formula({"P": 3 * (4 + 1)}, {"P": 3 * 2 * 2 * 11 * 5}),
    # the same in, the gradient out; windows over 3 maps
    "loss backward": Formula({"P": 3 * (4 + 1 + 4)}, {"P": 3 * 2 * 2 * 11 * 3}),
    # parameter, gradient, two moments in; all but the gradient out
    "adam": Formula({"M": 28}, {"M": 14}),
    # a number in and out
    "scan": Formula({"E": 8}, {"E": 1}),
    # key and value in and out
    "sort": Formula({"E": 16}, {}),
    "quantize": Formula({"E": 8}, {"E": 5}),
    # a number in; about two exponentials
    "rate": Formula({"E": 4}, {"E": 40}),
}
"""The formulas; keys are the stage names of the training step's profile."""


def count_work(device: Device, frame: Frame, scene: DeviceScene, elements: int) -> Counts:
    """The counts of a render; blended pairs are those that the blend kernel itself reports."""
    made = blend_decisions(device, frame.blended, device.zeros(frame.image.shape))[0]
    held = frame.needed(device)
    return Counts(
        A=len(scene.anchors),
        V=held.visible,
        N=held.gaussians,
        I=held.entries,
        B=int(made.contributed.sum()),
        P=frame.view.size[0] * frame.view.size[1],
        M=sum(array.size for name, array in scene.items() if name != "position"),
        E=elements,
    )


@dataclass(frozen=True)
class Share:
    """Bytes and operations of a stage, the rates reached, and the larger share of a limit."""

    bytes: int
    flops: int
    gigabytes_per_second: float
    gigaflops: float
    of_limit: float
    bound: str


def share_of_limit(
    name: str, counts: Counts, milliseconds: float, limits: DeviceLimits
) -> Share | None:
    """How near a stage comes to the device's limits; None if it has no formula."""
    formula = FORMULAS.get(name)
    if formula is None or milliseconds <= 0:
        return None
    moved, made = formula.evaluate(counts)
    rate, speed = 1e3 * moved / milliseconds, 1e3 * made / milliseconds
    by_memory, by_arithmetic = rate / limits.bytes_per_second, speed / limits.flops_per_second
    bound = "copy" if by_memory > by_arithmetic else "FMA"
    return Share(moved, made, rate / 1e9, speed / 1e9, max(by_memory, by_arithmetic), bound)


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
) -> int:
    """Measure, print and, if asked, write JSON; exit code 1 if an error exceeds its limit."""
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
