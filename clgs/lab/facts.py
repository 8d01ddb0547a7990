"""Where a figure was measured, and the one way in which figures are shown and written."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from clgs.files import write_json
from clgs.machine import host_facts
from clgs.opencl.device import Device

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
