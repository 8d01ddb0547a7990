"""The stored rows of a table, grouped: reports and figures are made of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean

from reproduce.baseline import Point
from reproduce.curves import Curve, CurveError, bd_rate, rate_at
from reproduce.table import Entry, Experiment, Table, run_folder
from reproduce.worker import Row, stored_row

BD_SETTING = "size_lambda"
"""Curves over this setting are those that BD-rates are computed of."""


@dataclass(frozen=True)
class Cell:
    """An entry of the table and its row."""

    entry: Entry
    row: Row


@dataclass(frozen=True)
class Group:
    """The cells of one experiment, scene and label: the seeds."""

    entry: Entry
    rows: list[Row]

    def mean(self, name: str) -> float:
        """The mean of a field of the rows."""
        return mean(float(row[name]) for row in self.rows)

    def range(self, name: str) -> tuple[float, float]:
        """Smallest and largest value of a field of the rows."""
        values = [float(row[name]) for row in self.rows]
        return min(values), max(values)


@dataclass(frozen=True)
class Comparison:
    """A curve against another state: the BD-rate, or the bytes at the PSNR of its one point."""

    experiment: str
    scene: str
    kind: str
    change: float | None
    reason: str = ""


@dataclass
class Results:
    """All that is finished of a table."""

    table: Table
    cells: list[Cell]
    missing: list[Entry] = field(default_factory=list)

    def groups(self, experiment: str) -> list[Group]:
        """The groups of an experiment, in the order of the table."""
        found: dict[tuple[str, str], Group] = {}
        for cell in self.cells:
            if cell.entry.experiment == experiment:
                key = cell.entry.scene, cell.entry.label
                found.setdefault(key, Group(cell.entry, [])).rows.append(cell.row)
        return list(found.values())

    def experiments(self, kind: str) -> list[Experiment]:
        """The experiments of a kind that have a cell."""
        there = {cell.entry.experiment for cell in self.cells}
        return [
            one for one in self.table.experiments.values() if one.kind == kind and one.name in there
        ]

    def rows(self) -> list[Row]:
        """Every row once."""
        return list({cell.row["run"]: cell.row for cell in self.cells}.values())


def read_results(table: Table, all_entries: Iterable[Entry], output: Path) -> Results:
    """What the folders of runs hold."""
    found = Results(table, [])
    rows: dict[str, Row | None] = {}
    for one in all_entries:
        if one.run not in rows:
            rows[one.run] = stored_row(run_folder(output, one.run), one.run)
        row = rows[one.run]
        if row is None:
            found.missing.append(one)
        else:
            found.cells.append(Cell(one, row))
    return found


def compare(results: Results, baseline: Sequence[Point]) -> list[Comparison]:
    """Every curve over lambda against the points of another state on the same scene.

    Of those, the points of equal steps and of the same experiment count, where the state tells.
    """
    found = []
    for one in results.experiments("curve"):
        if one.setting != BD_SETTING:
            continue
        groups = results.groups(one.name)
        for scene in dict.fromkeys(group.entry.scene for group in groups):
            own = [group for group in groups if group.entry.scene == scene]
            ours = [(group.mean("bytes"), group.mean("psnr")) for group in own]
            found.append(_compare(one.name, scene, ours, matching(baseline, groups, scene)))
    return found


def matching(baseline: Sequence[Point], groups: Sequence[Group], scene: str) -> Curve:
    """The points (bytes, dB) of another state that an experiment's curve is compared with."""
    steps = {row["steps"] for group in groups for row in group.rows}
    names = {"", *(group.entry.experiment for group in groups)}
    return [
        (point.bytes, point.psnr)
        for point in baseline
        if point.scene == scene
        and point.experiment in names
        and (point.steps is None or point.steps in steps)
    ]


def _compare(experiment: str, scene: str, ours: Curve, theirs: Curve) -> Comparison:
    kind = "bytes at its PSNR" if len(theirs) == 1 else "BD-rate"
    if not theirs:
        return Comparison(experiment, scene, kind, None, "the baseline has no point of it")
    try:
        change = rate_at(ours, theirs[0]) if len(theirs) == 1 else bd_rate(ours, theirs)
    except CurveError as error:
        return Comparison(experiment, scene, kind, None, str(error))
    return Comparison(experiment, scene, kind, change)
