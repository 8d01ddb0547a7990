"""`clgs selftest`: every stage against its float64 reference on every device."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import add_overwrite
from clgs.lab.commands import add_device_option, open_devices

if TYPE_CHECKING:
    from clgs.lab.selftest.reference_render import Check
    from clgs.opencl.device import Device


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = (
        "Error and time of every stage on every device, one line per device; the whole table "
        "for a single device or with --verbose. Exit code 1 if an error exceeds its limit."
    )
    add_device_option(parser)
    parser.add_argument("--verbose", action="store_true", help="show every check of every device")
    parser.add_argument("--json", type=Path, metavar="F", help="write all checks to F")
    add_overwrite(parser, "F if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Run the checks; exit code 0, or 1 if one fails."""
    from dataclasses import asdict

    from clgs.errors import explain
    from clgs.files import write_json
    from clgs.lab.figures import machine_facts
    from clgs.lab.selftest.render_checks import selftest
    from clgs.workflow.outputs import check_new

    if args.json:
        check_new(args.json, args.overwrite)
    records, tables, failures = [], [], 0
    for index, device in open_devices(args.device):
        checks: list[Check] = []
        problem = ""
        try:
            for check in selftest(device):
                checks.append(check)
        except Exception as error:  # other devices still follow
            problem = explain(error)[0]
        failures += sum(not check.passed for check in checks) + bool(problem)
        found = [asdict(check) | {"passed": check.passed} for check in checks]
        records.append(machine_facts(device) | {"error": problem, "checks": found})
        tables.append((device, checks))
        print(f"{index}: {device.name} ({device.specialisation}): {verdict(checks, problem)}")
    for device, checks in tables:
        if args.verbose or len(tables) == 1:
            show(device, checks)
    if args.json:
        write_json(args.json, {"devices": records})
    print("all checks passed" if not failures else f"{failures} checks failed")
    return 1 if failures else 0


def verdict(checks: list[Check], problem: str) -> str:
    """One line on a device; ``problem``: the error that stopped its checks, or empty."""
    failed = [check for check in checks if not check.passed]
    if problem:
        return f"FAIL: {problem}"
    if failed:
        names = ", ".join(f"{check.stage} {check.quantity}" for check in failed)
        return f"FAIL: {len(failed)} of {len(checks)} checks: {names}"
    worst = max(checks, key=lambda check: check.share)
    nearest = f"{worst.stage} {worst.quantity} at {worst.share:.2f} of its limit"
    return f"{len(checks)} check{'s' * (len(checks) != 1)} passed, nearest to its limit: {nearest}"


def show(device: Device, checks: list[Check]) -> None:
    """Print a row per check."""
    from clgs.lab.figures import show_table

    rows = (
        (
            f"{check.stage}: {check.quantity}",
            f"{check.error:.2e}",
            f"{check.limit:.0e}",
            f"{check.milliseconds:.2f}",
            "ok" if check.passed else "FAIL",
        )
        for check in checks
    )
    head = ("stage and quantity", "error", "limit", "ms", "")
    show_table(f"{device.name} ({device.specialisation})", head, rows)
