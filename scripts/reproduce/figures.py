"""The plots of a report, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clgs.lab.figures import MARKERS, PANEL, STYLE, require_pyplot, save
from reproduce.baseline import Point
from reproduce.curves import Curve
from reproduce.results import Group, Results, matching

KILO = 1000.0
COLUMNS = 4
"""Panels in a row."""


def draw_all(
    folder: Path, results: Results, baseline: Sequence[Point], published: dict[str, Any]
) -> dict[str, str]:
    """Draw every curve that there is data for; file names by the experiment's name.

    A figure shows PSNR against bytes in a panel per scene, with the points of another state and the
    published ones.
    """
    pyplot, found = require_pyplot(), {}
    for one in results.experiments("curve"):
        groups = results.groups(one.name)
        scenes = list(dict.fromkeys(group.entry.scene for group in groups))
        columns = min(COLUMNS, len(scenes))
        rows = -(-len(scenes) // columns)
        with pyplot.rc_context(STYLE):
            size = (columns * PANEL[0], rows * PANEL[1])
            figure, grid = pyplot.subplots(rows, columns, figsize=size, squeeze=False)
            for place, scene in zip(grid.flat, scenes, strict=False):
                own = [group for group in groups if group.entry.scene == scene]
                draw_curve(place, own, matching(baseline, groups, scene), published)
                place.set_title(f"{scene}: {one.setting}", loc="left")
            for place in list(grid.flat)[len(scenes) :]:
                place.set_axis_off()
            figure.tight_layout()
            found[one.name] = f"curve_{one.name}.svg"
            save(figure, folder / found[one.name])
    return found


def draw_curve(panel: Any, groups: list[Group], baseline: Curve, published: dict[str, Any]) -> None:
    """Draw the points of a scene, those of another state, and the published ones."""
    own = sorted(groups, key=lambda group: group.mean("bytes"))
    sizes = [group.mean("bytes") / KILO for group in own]
    panel.plot(sizes, [group.mean("psnr") for group in own], "o-", label="here")
    for group, size in zip(own, sizes, strict=True):
        place = size, group.mean("psnr")
        panel.annotate(
            group.entry.label, place, textcoords="offset points", xytext=(4, -9), fontsize=7
        )
    theirs = sorted((size / KILO, psnr) for size, psnr in baseline)
    if theirs:
        panel.plot(*zip(*theirs, strict=True), "s--", color="grey", label="baseline")
    for number, (method, figures) in enumerate(published["methods"].items()):
        if found := figures["scenes"].get(groups[0].entry.scene):
            size = found["megabytes"] * figures["megabyte"] / KILO
            mark = MARKERS[2 + number % (len(MARKERS) - 2)]
            panel.plot([size], [found["psnr"]], mark, color=f"C{number + 1}", label=method)
    panel.set(xlabel="kilobytes", ylabel="PSNR, dB")
    panel.legend(frameon=False, fontsize=7)
