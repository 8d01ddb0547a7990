"""The plots of a report, as SVG."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from clgs.lab.bench.plots import MARKERS, PANEL, STYLE, require_pyplot, save
from reproduce.baseline import Point
from reproduce.measure import ATTRIBUTES, LEVELS
from reproduce.results import Group, Results, matching, proxy_line, proxy_points
from reproduce.table import Experiment

KILO = 1000.0
COLUMNS = 4
"""Panels beside each other."""

SHOWN = {"paper": "proxy_entropy", "default": "proxy_classes"}
"""The estimate that each level of the encoder is drawn against: the nearest one."""

Draw = Callable[[Any], None]


def draw_all(
    folder: Path, results: Results, baseline: Sequence[Point], published: dict[str, Any]
) -> dict[str, str]:
    """Write every plot that there is data for; the file names by what they show.

    Keys: an experiment's name for each curve, ``proxy``, ``histograms``.
    """
    found = {}
    for one in results.experiments("curve"):
        panels = _curve_panels(one, results.groups(one.name), baseline, published)
        found[one.name] = _page(folder, f"curve_{one.name}.svg", panels)
    if panels := _proxy_panels(results):
        found["proxy"] = _page(folder, "proxy.svg", panels)
    if panels := _histogram_panels(results):
        found["histograms"] = _page(folder, "histograms.svg", panels, len(ATTRIBUTES))
    return found


def _page(folder: Path, name: str, panels: list[Draw], columns: int = COLUMNS) -> str:
    """A file of panels, row by row; returns its name."""
    pyplot = require_pyplot()
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    with pyplot.rc_context(STYLE):
        size = (columns * PANEL[0], rows * PANEL[1])
        figure, grid = pyplot.subplots(rows, columns, figsize=size, squeeze=False)
        for place, draw in zip(grid.flat, panels, strict=False):
            draw(place)
        for place in list(grid.flat)[len(panels) :]:
            place.set_axis_off()
        figure.tight_layout()
        save(figure, folder / name)
    return name


def _curve_panels(
    one: Experiment, groups: list[Group], baseline: Sequence[Point], published: dict[str, Any]
) -> list[Draw]:
    """PSNR against bytes, a panel a scene, with the other state and the published points."""

    def draw(panel: Any, scene: str) -> None:
        own = sorted(
            (group for group in groups if group.entry.scene == scene),
            key=lambda group: group.mean("bytes"),
        )
        sizes = [group.mean("bytes") / KILO for group in own]
        panel.plot(sizes, [group.mean("psnr") for group in own], "o-", label="here")
        for group, size in zip(own, sizes, strict=True):
            place = size, group.mean("psnr")
            panel.annotate(
                group.entry.label, place, textcoords="offset points", xytext=(4, -9), fontsize=7
            )
        theirs = sorted((size / KILO, psnr) for size, psnr in matching(baseline, groups, scene))
        if theirs:
            panel.plot(*zip(*theirs, strict=True), "s--", color="grey", label="baseline")
        for number, (method, figures) in enumerate(published["methods"].items()):
            if found := figures["scenes"].get(scene):
                size = found["megabytes"] * figures["megabyte"] / KILO
                mark = MARKERS[2 + number % (len(MARKERS) - 2)]
                panel.plot([size], [found["psnr"]], mark, color=f"C{number + 1}", label=method)
        panel.set(xlabel="kilobytes", ylabel="PSNR, dB")
        panel.set_title(f"{scene}: {one.setting}", loc="left")
        panel.legend(frameon=False, fontsize=7)

    scenes = dict.fromkeys(group.entry.scene for group in groups)
    return [lambda panel, scene=scene: draw(panel, scene) for scene in scenes]


def _proxy_panels(results: Results) -> list[Draw]:
    """Bits of the file against bits that are estimated, a panel a level of the encoder."""

    def draw(panel: Any, level: str) -> None:
        points = proxy_points(rows, SHOWN[level], level)
        across, up = ([value / (8 * KILO) for value in axis] for axis in zip(*points, strict=True))
        panel.plot(across, up, "o", markersize=4, alpha=0.6)
        ends = [0.0, max(across)]
        panel.plot(ends, ends, ":", color="grey", label="equal")
        if line := proxy_line(rows, SHOWN[level], level):
            fitted = [line.slope * x + line.intercept / (8 * KILO) for x in ends]
            name = f"slope {line.slope:.3f}, correlation {line.correlation:.4f}"
            panel.plot(ends, fitted, "-", label=name)
        panel.set(
            xlabel=f"estimate by {SHOWN[level].removeprefix('proxy_')}, kilobytes",
            ylabel="file, kilobytes",
        )
        panel.set_title(f"attributes, level {level}", loc="left")
        panel.legend(frameon=False, fontsize=7)

    rows = [row for row in results.rows() if row["bits"].get("proxy_classes")]
    return [lambda panel, level=level: draw(panel, level) for level in LEVELS] if rows else []


def _histogram_panels(results: Results) -> list[Draw]:
    """Shares of integers with the fitted laws: a row a main scene, a panel an attribute."""

    def draw(panel: Any, name: str, scene: str, found: dict[str, Any]) -> None:
        values = range(found["first"], found["first"] + len(found["share"]))
        panel.bar(values, found["share"], width=0.9, color="lightgrey", label="integers")
        panel.plot(values, found["channel"], "-", label="a Laplace law per channel")
        panel.plot(values, found["pooled"], "--", label="one law for all")
        least = min((share for share in found["share"] if share > 0), default=1e-6)
        panel.set(yscale="log", ylim=(least / 2, 1.5), xlabel=f"{name}, integer", ylabel="share")
        panel.set_title(scene, loc="left")
        panel.legend(frameon=False, fontsize=7)

    shown: dict[str, dict[str, Any]] = {}
    for one in results.experiments("main"):
        for group in results.groups(one.name):
            shown.setdefault(group.entry.scene, group.rows[0]["histograms"])
    return [
        lambda panel, name=name, scene=scene, found=found[name]: draw(panel, name, scene, found)
        for scene, found in shown.items()
        for name in ATTRIBUTES
        if found[name]["share"]
    ]
