"""`clgs bench accuracy`: what every accuracy setting costs and how far it is from the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clgs.errors import UsageError
from clgs.lab.bench.accuracy_points import (
    PRESET_SWEEP,
    Point,
    SceneFigures,
    accuracy_settings,
    against_parity,
    bench_accuracy,
    synthetic_subjects,
)
from clgs.lab.figures import (
    MARKERS,
    PANEL,
    STYLE,
    require_pyplot,
    save,
    show_table,
    write_figures,
)
from clgs.opencl.device import Device
from clgs.workflow.options import ViewOptions
from clgs.workflow.scenes import read_scene
from clgs.workflow.views import select_views

ACROSS = ("forward, ms", "forward, ms", "forward and backward, ms")
UP = (
    "image error p99.9, levels",
    "largest image error, levels",
    "worst gradient error, relative L2",
)
"""Labels of the axes of the three panels of a scene."""

SMALLEST = 1e-7
"""Errors below this are drawn as this: a logarithm has no zero."""


def run(
    scenes: Sequence[str],
    sweeps: Sequence[str],
    scene: Path | None,
    view: int,
    views: ViewOptions,
    repeats: int,
    seed: int,
    output: Path | None,
    plot: Path | None,
) -> None:
    """Measure, print and, if asked, write JSON and draw.

    Raises:
        UsageError: no scene was asked for, or ``view``, one of ``views`` of ``scene``, does not
            exist.
    """
    settings = accuracy_settings(sweeps)
    if (scene is None) != (views.data is None):
        raise UsageError("--scene and --data belong together")
    subjects = synthetic_subjects(scenes, seed)
    if scene is not None and views.data is not None:
        quantized, _ = read_scene(scene)
        chosen = select_views(scene, quantized, views)
        if not 0 <= view < len(chosen):
            raise UsageError(f"--view {view}: there are {len(chosen)}, from 0")
        name = views.data.resolve().name
        subjects.append((name, quantized.dequantize(), chosen[view].camera))
    if not subjects:
        raise UsageError("no scene: name some with --scenes, or --scene and --data")
    device = Device(views.device)
    found = []
    for subject in subjects:
        found.append(bench_accuracy(device, *subject, settings, repeats))
        show(found[-1])
    figures = [asdict(one) | {"against_parity": against_parity(one)} for one in found]
    write_figures(output, {"scenes": figures}, device)
    if plot:
        plot_accuracy(plot, found, f"{device.name}, {device.specialisation} form")


def show(figures: SceneFigures) -> None:
    """Print a row per setting, then the presets compared with "parity"."""
    rows = []
    for point in figures.points:
        forward, image, gradient = point.forward, point.image, point.gradient
        worst = [gradient.relative_l2, gradient.p99] if gradient else []
        errors = [f"{max(by_tensor.values()):.1e}" for by_tensor in worst]
        row = (
            f"{point.sweep} {point.label}",
            f"{forward.median:.2f}",
            f"{forward.low:.1f}-{forward.high:.1f}",
            f"{point.both.median:.2f}" if point.both else "",
            f"{image.p999:.2g}",
            f"{image.largest:.2g}",
            f"{image.psnr:.1f}",
            f"{point.stopped.largest:.2g}" if point.stopped else "",
        )
        rows.append((*row, *errors))
    width, height = figures.size
    title = (
        f"{figures.name}: {figures.gaussians:,} Gaussians, "
        f"{figures.intersections:,} intersections, {width} x {height}"
    )
    columns = ("forward", "5-95 %", "both", "p99.9", "max", "dB", "stop", "d L2", "d p99")
    show_table(title, ("setting", *columns), rows)
    for preset, ratio in against_parity(figures).items():
        both = "" if ratio["both"] is None else f", {ratio['both']:.2f}x with gradients"
        print(f"  {preset} against parity: {ratio['forward']:.2f}x{both}")


def plot_accuracy(path: Path, subjects: Sequence[SceneFigures], title: str) -> None:
    """Error against time, log-log: a row per scene; image p99.9, image maximum, gradients."""
    pyplot = require_pyplot()
    from matplotlib.ticker import FuncFormatter, LogLocator

    plain = FuncFormatter(lambda value, _: f"{value:g}")  # 20 and 30 instead of powers of ten
    with pyplot.rc_context(STYLE):
        size = (3 * PANEL[0], len(subjects) * PANEL[1] + 0.8)
        figure, rows = pyplot.subplots(len(subjects), 3, figsize=size, squeeze=False)
        for panels, subject in zip(rows, subjects, strict=True):
            _plot_curves(panels[0], subject.points, lambda one: one.image.p999)
            _plot_curves(panels[1], subject.points, lambda one: one.image.largest)
            _plot_curves(panels[2], subject.points, _worst_gradient)
            for panel, across, up in zip(panels, ACROSS, UP, strict=True):
                panel.set(xscale="log", yscale="log", xlabel=across, ylabel=up)
                panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                panel.xaxis.set_minor_locator(LogLocator(subs=(3.0, 4.0, 7.0)))
                panel.xaxis.set_major_formatter(plain)
                panel.xaxis.set_minor_formatter(plain)
            width, height = subject.size
            panels[0].set_title(
                f"{subject.name}: {subject.gaussians:,} Gaussians, {width} x {height}", loc="left"
            )
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncols=len(labels), frameon=False)
        figure.suptitle(title, y=0.005, va="bottom", fontsize=8)
        figure.tight_layout(rect=(0, 0.03, 1, 0.96))
        save(figure, path)


def _worst_gradient(point: Point) -> float | None:
    """The largest error of all tensors; None if the setting has no gradients."""
    return max(point.gradient.relative_l2.values()) if point.gradient else None


def _plot_curves(
    panel: Any, points: Sequence[Point], error: Callable[[Point], float | None]
) -> None:
    """Draw a line per sweep, in its order, and presets as black marks with their names."""
    for number, sweep in enumerate(dict.fromkeys(point.sweep for point in points)):
        own = [one for one in points if one.sweep == sweep and error(one) is not None]
        times = [(one.both if error is _worst_gradient else one.forward) for one in own]
        x = [one.median for one in times if one]
        y = [max(error(one) or 0.0, SMALLEST) for one in own]
        preset = sweep == PRESET_SWEEP
        panel.plot(
            x,
            y,
            marker=MARKERS[number % len(MARKERS)],
            markersize=7 if preset else 4,
            linewidth=0 if preset else 1.2,
            color="black" if preset else f"C{number - 1}",
            zorder=3 if preset else 2,
            label=sweep,
        )
        for one, place in zip(own, zip(x, y, strict=True), strict=True):
            panel.annotate(
                one.label,
                place,
                textcoords="offset points",
                xytext=(5, 4) if preset else (4, -8),
                fontsize=9 if preset else 6,
                fontweight="bold" if preset else "normal",
            )
