"""Figures of benchmarks as SVG; matplotlib is an optional dependency."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from clgs.errors import ClgsError
from clgs.files import atomic_path
from clgs.lab.bench.accuracy import Point, SubjectFigures
from clgs.lab.bench.accuracy_settings import PRESET_SWEEP
from clgs.lab.bench.scaling import Scaling, shown

PANEL = (4.6, 3.4)
"""Inches."""

SMALLEST = 1e-7
"""Errors below are drawn here: a logarithm has no zero."""

MARKERS = "osD^vPX*"
STYLE = {
    "svg.hashsalt": "clgs",
    "svg.fonttype": "none",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def require_pyplot() -> Any:
    """matplotlib.pyplot, drawing without a screen.

    Raises:
        ClgsError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise ClgsError('plots need matplotlib: pip install "clgs[plot]"') from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def plot_accuracy(path: Path, subjects: Sequence[SubjectFigures], title: str) -> None:
    """Error against time, log-log: a row per scene; image p99.9, image maximum, gradients."""
    pyplot = require_pyplot()
    with pyplot.rc_context(STYLE):
        size = (3 * PANEL[0], len(subjects) * PANEL[1] + 0.8)
        figure, rows = pyplot.subplots(len(subjects), 3, figsize=size, squeeze=False)
        for panels, subject in zip(rows, subjects, strict=True):
            _accuracy_row(panels, subject)
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncols=len(labels), frameon=False)
        figure.suptitle(title, y=0.005, va="bottom", fontsize=8)
        figure.tight_layout(rect=(0, 0.03, 1, 0.96))
        save(figure, path)


def _accuracy_row(panels: Sequence[Any], subject: SubjectFigures) -> None:
    drawn = [
        ("forward, ms", "image error p99.9, levels", _image_points(subject.points, "p999")),
        ("forward, ms", "largest image error, levels", _image_points(subject.points, "largest")),
        (
            "forward and backward, ms",
            "worst gradient error, relative L2",
            _gradient_points(subject.points),
        ),
    ]
    for panel, (across, up, points) in zip(panels, drawn, strict=True):
        _curves(panel, list(points))
        panel.set(xscale="log", yscale="log", xlabel=across, ylabel=up)
        _plain_ticks(panel.xaxis)
    width, height = subject.size
    panels[0].set_title(
        f"{subject.name}: {subject.gaussians:,} Gaussians, {width} x {height}", loc="left"
    )


def _plain_ticks(axis: Any) -> None:
    """Numbers such as 20 and 30 for powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(LogLocator(subs=(3.0, 4.0, 7.0)))
    for minor in (False, True):
        formatter = FuncFormatter(lambda value, _: f"{value:g}")
        (axis.set_minor_formatter if minor else axis.set_major_formatter)(formatter)


Placed = tuple[str, str, float, float]
"""Sweep, label, milliseconds, error."""


def _image_points(points: Iterable[Point], measure: str) -> Iterable[Placed]:
    for one in points:
        yield one.sweep, one.label, one.forward.median, getattr(one.image, measure)


def _gradient_points(points: Iterable[Point]) -> Iterable[Placed]:
    for one in points:
        if one.both is not None and one.gradient is not None:
            worst = max(one.gradient.relative_l2.values())
            yield one.sweep, one.label, one.both.median, worst


def _curves(panel: Any, points: list[Placed]) -> None:
    """A line a sweep in its order; presets as black marks with their names."""
    for number, sweep in enumerate(dict.fromkeys(point[0] for point in points)):
        own = [point for point in points if point[0] == sweep]
        x, y = [point[2] for point in own], [max(point[3], SMALLEST) for point in own]
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
        for label, across, up in zip((point[1] for point in own), x, y, strict=True):
            panel.annotate(
                label,
                (across, up),
                textcoords="offset points",
                xytext=(5, 4) if preset else (4, -8),
                fontsize=9 if preset else 6,
                fontweight="bold" if preset else "normal",
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


def save(figure: Any, path: Path) -> None:
    """Write the figure as SVG with the same bytes for the same figures."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="svg", metadata={"Date": None})
    require_pyplot().close(figure)
