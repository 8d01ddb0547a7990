"""What all measurements share: where a figure was measured, how it is shown, written and drawn.

Tasks that are timed take turns, so that none has the better minute. matplotlib is an optional
dependency.
"""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table

from clgs.errors import ClgsError, UsageError
from clgs.files import atomic_path, check_target, write_json
from clgs.machine import host_facts
from clgs.opencl.device import Device
from clgs.workflow.outputs import check_new

WIDTH = 110
"""Characters that a table may need; a narrower terminal breaks its lines."""


def machine_facts(device: Device) -> dict[str, object]:
    """Names and versions of what made a figure; no host names and no times."""
    described = device.cl_device
    facts = {
        "name": device.name,
        "platform": described.platform.name.strip(),
        "version": described.version.strip(),
        "driver": described.driver_version.strip(),
        "compute_units": described.max_compute_units,
        "native_vector_width": described.native_vector_width_float,
        "specialisation": device.specialisation,
    }
    return {"device": facts, **host_facts()}


def write_figures(
    path: Path | None, figures: Mapping[str, object], device: Device | None = None
) -> None:
    """Write figures as JSON with the command that runs and its machine; None: write nothing."""
    if path is not None:
        facts = machine_facts(device) if device else host_facts()
        write_json(path, {"command": shlex.join(["clgs", *sys.argv[1:]]), **facts, **figures})


def show_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table: first column to the left, others to the right; an empty row is a line."""
    table = Table(title=title)
    for number, name in enumerate(head):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        if row:
            table.add_row(*row)
        else:
            table.add_section()
    Console(width=max(Console().width, WIDTH)).print(table)


Key = TypeVar("Key")


def take_turns(
    tasks: Mapping[Key, Callable[[], object]], repeats: int, warm_up: int = 1, seconds: float = 0.0
) -> dict[Key, list[float]]:
    """Milliseconds of every task in ``repeats`` rounds, after ``warm_up`` rounds that do not count.

    seconds: how long a task runs untimed before each time that counts.
    """
    found: dict[Key, list[float]] = {key: [] for key in tasks}
    for _ in range(warm_up + repeats):
        for key, task in tasks.items():
            until = time.perf_counter() + seconds
            while time.perf_counter() < until:
                task()
            start = time.perf_counter()
            task()
            found[key].append(1e3 * (time.perf_counter() - start))
    return {key: times[warm_up:] for key, times in found.items()}


def finished_times(device: Device, work: Callable[[], object], repeats: int) -> list[float]:
    """Milliseconds of ``work``, with what it leaves to the device, after a run to warm up."""

    def finish() -> None:
        work()
        device.finish()

    return take_turns({"": finish}, repeats)[""]


PANEL = (4.6, 3.4)
"""Inches."""

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


def check_figure_files(output: Path | None, plot: Path | None, overwrite: bool) -> None:
    """Refuse, before anything is measured, files that could not be written.

    Raises:
        UsageError: ``plot`` is no .svg file, or the same file as ``output``.
        ClgsError: matplotlib is missing.
        ExistsError, OutputError: as of :func:`clgs.workflow.outputs.check_new`.
    """
    if plot and plot.suffix.lower() != ".svg":
        raise UsageError(f"{plot}: plots are SVG; name a file that ends in .svg")
    targets = [check_target(path) for path in (output, plot) if path]
    if len(set(targets)) < len(targets):
        raise UsageError(f"{plot}: --output and --plot name the same file; choose two")
    for path in filter(None, (output, plot)):
        check_new(path, overwrite)
    if plot:
        require_pyplot()


def save(figure: Any, path: Path) -> None:
    """Write the figure as SVG with the same bytes for the same figures."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="svg", metadata={"Date": None})
    require_pyplot().close(figure)
