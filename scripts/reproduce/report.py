"""The report: results.md with its plots, results.json and the files of main rows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from clgs.files import atomic_write
from reproduce import tables
from reproduce.baseline import Point, read_published
from reproduce.figures import draw_all
from reproduce.results import Results, compare
from reproduce.table import run_folder

NAME = "results"
"""Name of the files, and of the folder next to them that holds plots and scenes."""

KEPT_BYTES = 1_000_000
"""Scenes of main rows up to this size are copied for others to score; of all there is a hash."""


def write_report(
    folder: Path,
    results: Results,
    output: Path,
    command: str,
    baseline: Sequence[Point] = (),
    note: str = "",
) -> list[Path]:
    """Write the report of what is finished; returns its files.

    Args:
        folder: receives results.md, results.json and the folder results.
        results: as read from the runs.
        output: the folder of the runs.
        command: what makes the report again.
        baseline: points of another state.
        note: a sentence for the head of the page.
    """
    inner = folder / NAME
    inner.mkdir(parents=True, exist_ok=True)
    published = read_published()
    plots = draw_all(inner, results, baseline, published)
    kept = _keep_scenes(inner, results, output)
    compared = compare(results, baseline) if baseline else []
    text = tables.page(results, command, plots, kept, compared, published, note)
    whole = {
        "command": command,
        "rows": [{**cell.row, **asdict(cell.entry)} for cell in results.cells],
        "missing": sorted({one.run for one in results.missing}),
        "baseline": [asdict(one) for one in compared],
    }
    contents = {
        folder / f"{NAME}.md": text,
        folder / f"{NAME}.json": json.dumps(whole, indent=1) + "\n",
    }
    for path, content in contents.items():
        atomic_write(path, content.encode())
    return [*contents, *(inner / name for name in (*plots.values(), *kept.values()))]


def _keep_scenes(folder: Path, results: Results, output: Path) -> dict[str, str]:
    """Copy the small files of main rows; the copies' names by run."""
    found = {}
    for one in results.experiments("main"):
        for cell in results.cells:
            entry, row = cell.entry, cell.row
            if entry.experiment == one.name and row["bytes"] <= KEPT_BYTES:
                name = f"{entry.scene}_{one.name}_{entry.seed}.clgs"
                data = (run_folder(output, entry.run) / "scene.clgs").read_bytes()
                atomic_write(folder / name, data)
                found[entry.run] = name
    return found
