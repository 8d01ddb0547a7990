"""Runs the parts of `clgs accept` one after the other; what is done is on disk at once."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clgs.cli.tell import tell
from clgs.errors import DeviceError
from clgs.files import write_json
from clgs.lab.accept.part import Outcome, Part, run_part
from clgs.machine import host_facts
from clgs.opencl.choose import choose_device, list_devices

FORMAT = "clgs accept 1"
KEPT = (
    "conformance", "selftest", "stages", "step", "large step", "first start", "second start",
    "gsplat", "gsplat large",
)  # fmt: skip
"""Parts whose figures go into the record, besides the line that is told."""


def chosen_device(name: str | None, folder: Path) -> dict[str, Any]:
    """What `clgs devices` says of the device of that number or name, or of the usual one.

    Raises:
        DeviceError: there is none, or asking for it crashed.
        UsageError: ``name`` is empty.
    """
    outcome = run_part(Part("devices", ("devices", "--json"), lambda folder: ""), folder)
    if not outcome.passed:
        found_by = "; scripts/accept_gpu.sh finds out which driver crashes, and goes on without it"
        remedy = found_by if "signal" in outcome.told else ""
        raise DeviceError(f"`clgs devices`: {outcome.told}{remedy}")
    found = json.loads((folder / "devices.out").read_text())
    number = list_devices().index(choose_device(name))  # which did not crash in the part
    return dict(found[number])


def run_parts(
    todo: list[Part], folder: Path, device: dict[str, Any], output: Path
) -> list[Outcome]:
    """Run all parts, each line as it is told; ``output`` has every part that ended."""
    outcomes: list[Outcome] = []
    for number, part in enumerate(todo, 1):
        tell(f"[{number}/{len(todo)}] {part.name} ...")
        outcome = run_part(part, folder)
        outcomes.append(outcome)
        found = record(outcomes, folder, device, complete=number == len(todo))
        write_json(output, found)
    return outcomes


def record(
    outcomes: list[Outcome], folder: Path, device: dict[str, Any], complete: bool
) -> dict[str, Any]:
    """Everything, ready for JSON; what the parts printed may name the user's own folders.

    complete: whether these are all parts, as they are not after an interruption.
    """
    return {
        "format": FORMAT,
        "complete": complete,
        **host_facts(),
        "device": device,
        "parts": [_part(one, folder) for one in outcomes],
    }


def _part(outcome: Outcome, folder: Path) -> dict[str, Any]:
    here = str(folder)
    plain = asdict(outcome)
    plain["words"] = [word.replace(here, "FOLDER") for word in outcome.words]
    plain["printed"] = outcome.printed.replace(here, "FOLDER")
    path = folder / f"{outcome.name}.json"
    if outcome.name in KEPT and path.exists():
        plain["figures"] = json.loads(path.read_text())
    return plain
