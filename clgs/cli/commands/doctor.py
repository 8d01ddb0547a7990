"""``clgs doctor``: what is wrong with a data set, or with this machine, and what to do."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clgs.doctor.finding import Finding
    from clgs.doctor.machine import ExaminedMachine

HEALTHY, BAD_DATA, NO_DEVICE = 0, 3, 4
"""Exit codes: no error was found, an error in the data, no device that computes what it should."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "Check a data set (Blender, transforms.json, COLMAP): paths, poses, lenses, photos, "
        "masks. Without DATA, this machine: devices, with a second of checks of each, "
        "drivers, memory, disk. Each finding has a remedy. Exit code 3 if the data have an "
        "error, 4 if no device can be used, 0 otherwise, with warnings too."
    )
    parser.add_argument("data", nargs="?", type=Path, metavar="DATA", help="folder of a data set")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Print what was found; the exit code says whether there was an error.

    Raises:
        DataError: there is no data set.
    """
    from dataclasses import asdict

    from clgs.doctor.dataset import examine
    from clgs.doctor.finding import ERROR
    from clgs.doctor.machine import examine_machine

    if args.data is None:
        machine = examine_machine()
        code = HEALTHY if machine.usable else NO_DEVICE
        document: dict[str, Any] = {"machine": machine.facts}
        document["devices"] = [asdict(device) for device in machine.devices]
        heading, findings = _machine_lines(machine), machine.findings
    else:
        examined = examine(args.data)
        findings = examined.findings
        bad = any(finding.level == ERROR for finding in findings)
        code = BAD_DATA if bad else HEALTHY
        document, heading = {"data": examined.summary}, [examined.summary]
    if args.json:
        _print_json(document | {"findings": [asdict(finding) for finding in findings]})
    else:
        for line in (*heading, *_finding_lines(findings)):
            print(line)
    return code


def _print_json(document: dict[str, Any]) -> None:
    import json

    print(json.dumps(document, indent=2))


def _machine_lines(machine: ExaminedMachine) -> list[str]:
    lines = [f"{name:<9}  {text}" for name, text in machine.facts.items()]
    for one in machine.devices:
        checks = f"{one.checks} checks passed in {one.seconds:.1f} s"
        lines.append(f"device {one.index}   {one.name}: {checks}")
    return lines


def _finding_lines(findings: list[Finding]) -> list[str]:
    """Two lines for each finding, then their number."""
    from clgs.doctor.finding import LEVELS

    lines = []
    for one in findings:
        where = f"{one.where}: " if one.where else ""
        lines.append(f"{one.level:<8} {where}{one.problem}")
        lines.append(f"{'':<8} -> {one.remedy}")
    counts = {level: sum(one.level == level for one in findings) for level in LEVELS}
    parts = [f"{n} {level}{'s' * (n != 1)}" for level, n in counts.items() if n]
    return [*lines, ", ".join(parts) or "nothing found"]
