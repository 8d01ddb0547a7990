"""``clgs doctor``: what is wrong with a data set, or with this machine, and what to do."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

HEALTHY, BAD_DATA, NO_DEVICE = 0, 3, 4
"""Exit codes: no error was found, an error in the data, no device that computes what it should."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "Check a data set (Blender, transforms.json, COLMAP): paths, poses, lenses, photos, "
        "masks. Without DATA, this machine: devices, on which all programs are built and some "
        "are checked, drivers, memory, disk. Each finding has a remedy. Exit code 3 if the data "
        "have an error, 4 if no device can be used, 0 otherwise, with warnings too."
    )
    parser.add_argument("data", nargs="?", type=Path, metavar="DATA", help="folder of a data set")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Print what was found; the exit code says whether there was an error."""
    import json
    from dataclasses import asdict

    from clgs.doctor import ERROR, LEVELS
    from clgs.doctor.dataset import examine
    from clgs.doctor.machine import examine_machine

    document: dict[str, Any]
    if args.data is None:
        machine = examine_machine()
        findings, code = machine.findings, HEALTHY if machine.devices else NO_DEVICE
        document = {"machine": machine.facts}
        document["devices"] = [asdict(device) for device in machine.devices]
        lines = [f"{name:<9}  {text}" for name, text in machine.facts.items()]
        for one in machine.devices:
            checks = f"{one.checks} checks passed in {one.seconds:.1f} s"
            lines.append(f"device {one.index}   {one.name}: {checks}")
    else:
        examined = examine(args.data)
        findings = examined.findings
        bad = any(finding.level == ERROR for finding in findings)
        code = BAD_DATA if bad else HEALTHY
        document, lines = {"data": examined.summary}, [examined.summary]
    if args.json:
        document["findings"] = [asdict(finding) for finding in findings]
        print(json.dumps(document, indent=2))
        return code
    for finding in findings:
        where = f"{finding.where}: " if finding.where else ""
        lines.append(f"{finding.level:<8} {where}{finding.problem}")
        lines.append(f"{'':<8} -> {finding.remedy}")
    counts = {level: sum(one.level == level for one in findings) for level in LEVELS}
    parts = [f"{n} {level}{'s' * (n != 1)}" for level, n in counts.items() if n]
    print(*lines, ", ".join(parts) or "nothing found", sep="\n")
    return code
