"""`clgs bench scaling`: growth of a step's time and memory with Gaussians and pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

from clgs.cli.tell import tell
from clgs.lab.bench.step import stream, trainer_of
from clgs.lab.figures import (
    PANEL,
    STYLE,
    require_pyplot,
    save,
    show_table,
    write_figures,
)
from clgs.lab.scenes import anchor_scene, camera_of
from clgs.opencl.device import Device
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene

GAUSSIANS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)
GROWTHS = (1, 2, 4, 8)
SIZES = (200, 400, 800, 1414, 2000, 2828)
FIXED_GAUSSIANS, FIXED_SIZE = 100_000, 400
LEAST_REPEATS, SECONDS = 3, 4.0
"""A size is run this often at least, and about this long at most."""


@dataclass(frozen=True)
class Run:
    """One size: what the step worked on, its milliseconds, and the device memory it needed."""

    gaussians: int
    intersections: int
    pixels: int
    milliseconds: float
    peak_bytes: int


@dataclass(frozen=True)
class Growth:
    """Exponent e of time ~ count^e by least squares on logarithms.

    Over all sizes; and over the larger half, in which the fixed costs of a step weigh less. None if
    there were fewer than two sizes.
    """

    exponent: float | None
    exponent_of_larger_half: float | None


@dataclass(frozen=True)
class Memory:
    """Bytes of device memory that one more costs: each the slope of its own sweep.

    A Gaussian and a pixel bring their intersections with them; those are in their bytes. None if
    there were fewer than two sizes.
    """

    per_gaussian: float | None
    per_intersection: float | None
    per_pixel: float | None


@dataclass(frozen=True)
class Scaling:
    """The sweeps and what follows from them; by_intersections: Gaussians grow at fixed numbers."""

    by_gaussians: list[Run]
    by_pixels: list[Run]
    by_intersections: list[Run]
    time_by_gaussians: Growth
    time_by_pixels: Growth
    memory: Memory


def run(
    gaussians: Sequence[int] | None,
    sizes: Sequence[int] | None,
    repeats: int,
    device: str | None,
    output: Path | None,
    plot: Path | None,
) -> None:
    """Measure, print and, if asked, write JSON and draw."""
    opened = Device(device)
    found = bench_scaling(
        lambda: Device(device),
        gaussians or GAUSSIANS,
        sizes or SIZES,
        repeats,
        lambda line: tell(f"clgs: {line}"),
    )
    show(found)
    write_figures(output, asdict(found), opened)
    if plot:
        plot_scaling(plot, found, f"{opened.name}, {opened.specialisation} form")


def bench_scaling(
    open_device: Callable[[], Device],
    gaussians: Sequence[int],
    sizes: Sequence[int],
    repeats: int,
    report: Callable[[str], None],
) -> Scaling:
    """Run all sweeps; every size has a device of its own, so that its memory is its own.

    By Gaussians: the picture stays, Gaussians of about a pixel become more. By pixels: the scene
    and the view stay, the picture becomes finer. By intersections: Gaussians become larger.
    """
    by_gaussians = []
    for count in gaussians:
        scene, camera = anchor_scene(count, FIXED_SIZE)
        by_gaussians.append(time_size(open_device(), scene, camera, repeats))
        report(f"{count:,} Gaussians: {by_gaussians[-1].milliseconds:.1f} ms")
    by_pixels = []
    scene, camera = anchor_scene(FIXED_GAUSSIANS, FIXED_SIZE)
    for size in sizes:
        by_pixels.append(time_size(open_device(), scene, camera_of(size, size), repeats))
        report(f"{size} x {size} pixels: {by_pixels[-1].milliseconds:.1f} ms")
    by_intersections = []
    for factor in GROWTHS:
        larger = scene.anchors.scaling + np.float32(np.log(factor))
        grown = replace(scene, anchors=replace(scene.anchors, scaling=larger))
        by_intersections.append(time_size(open_device(), grown, camera, repeats))
        report(f"Gaussians {factor} times as large: {by_intersections[-1].milliseconds:.1f} ms")
    return Scaling(
        by_gaussians,
        by_pixels,
        by_intersections,
        growth([(run.gaussians, run.milliseconds) for run in by_gaussians]),
        growth([(run.pixels, run.milliseconds) for run in by_pixels]),
        Memory(
            slope([(run.gaussians, run.peak_bytes) for run in by_gaussians]),
            slope([(run.intersections, run.peak_bytes) for run in by_intersections]),
            slope([(run.pixels, run.peak_bytes) for run in by_pixels]),
        ),
    )


def time_size(device: Device, scene: Scene, camera: Camera, repeats: int) -> Run:
    """Time steps of one size on a new device, and read how much memory they needed."""
    trainer = trainer_of(device, scene, camera)
    times = [by_clock for by_clock, _ in stream(trainer, LEAST_REPEATS)]
    more = min(repeats, round(1e3 * SECONDS / median(times))) - LEAST_REPEATS
    if more > 0:
        times += [by_clock for by_clock, _ in stream(trainer, more)]
    peak = device.reserved_bytes
    held = trainer.render_next().needed(device)
    pixels = camera.width * camera.height
    return Run(held.gaussians, held.entries, pixels, median(times), peak)


def growth(points: Sequence[tuple[float, float]]) -> Growth:
    """Exponents of points (count, time)."""
    ordered = np.log(np.array(sorted(points), np.float64).reshape(-1, 2))
    half = ordered[len(ordered) // 2 :] if len(ordered) >= 4 else ordered
    return Growth(slope(ordered), slope(half))


def slope(points: npt.ArrayLike) -> float | None:
    """Slope of the line through points (N, 2) by least squares; None for fewer than two."""
    x, y = np.asarray(points, np.float64).reshape(-1, 2).T
    return float(np.polyfit(x, y, 1)[0]) if len(np.unique(x)) > 1 else None


def shown(value: float | None, digits: int) -> str:
    """An exponent or bytes for people; a dash if there were fewer than two sizes."""
    return "-" if value is None else f"{value:.{digits}f}"


def show(found: Scaling) -> None:
    """Print a table per sweep, and the memory."""
    for name, runs, exponent in (
        ("by Gaussians", found.by_gaussians, found.time_by_gaussians),
        ("by pixels", found.by_pixels, found.time_by_pixels),
    ):
        title = (
            f"{name}: time ~ count^{shown(exponent.exponent, 2)} "
            f"(^{shown(exponent.exponent_of_larger_half, 2)} in the larger half)"
        )
        rows = (
            (
                f"{one.gaussians:,}",
                f"{one.intersections:,}",
                f"{one.pixels:,}",
                f"{one.milliseconds:.1f}",
                f"{1e6 * one.milliseconds / max(one.gaussians, 1):.0f}",
                f"{one.peak_bytes / 2**20:.0f}",
            )
            for one in runs
        )
        head = ("Gaussians", "intersections", "pixels", "step ms", "ns per Gaussian", "MiB")
        show_table(title, head, rows)
    memory = found.memory
    print(
        f"device memory: {shown(memory.per_gaussian, 0)} bytes per Gaussian and "
        f"{shown(memory.per_pixel, 0)} per pixel, each with its intersections; "
        f"{shown(memory.per_intersection, 0)} per intersection"
    )


def plot_scaling(path: Path, found: Scaling, title: str) -> None:
    """Time by Gaussians, time by pixels, and memory by Gaussians, log-log."""
    pyplot = require_pyplot()
    with pyplot.rc_context(STYLE):
        figure, panels = pyplot.subplots(1, 3, figsize=(3 * PANEL[0], PANEL[1] + 0.3))
        gaussians = [run.gaussians for run in found.by_gaussians]
        pixels = [run.pixels / 1e6 for run in found.by_pixels]
        for panel, x, runs, exponent, across in (
            (panels[0], gaussians, found.by_gaussians, found.time_by_gaussians, "Gaussians"),
            (panels[1], pixels, found.by_pixels, found.time_by_pixels, "megapixels"),
        ):
            panel.plot(x, [run.milliseconds for run in runs], "o-", label="measured")
            half = runs[len(runs) // 2].milliseconds, x[len(x) // 2]
            linear = [half[0] * value / half[1] for value in x]
            panel.plot(x, linear, ":", color="grey", label="linear")
            panel.set(xscale="log", yscale="log", xlabel=across, ylabel="training step, ms")
            panel.set_title(
                f"exponent {shown(exponent.exponent, 2)}, "
                f"{shown(exponent.exponent_of_larger_half, 2)} in the larger half",
                loc="left",
            )
            panel.legend(frameon=False)
        megabytes = [run.peak_bytes / 2**20 for run in found.by_gaussians]
        panels[2].plot(gaussians, megabytes, "o-")
        panels[2].set(xscale="log", yscale="log", xlabel="Gaussians", ylabel="device memory, MiB")
        panels[2].set_title(
            f"{shown(found.memory.per_gaussian, 0)} B a Gaussian, "
            f"{shown(found.memory.per_intersection, 0)} B an intersection",
            loc="left",
        )
        figure.suptitle(title, y=0.005, va="bottom", fontsize=8)
        figure.tight_layout(rect=(0, 0.04, 1, 1))
        save(figure, path)
