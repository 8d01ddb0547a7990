"""`clgs selftest`: every stage against its float64 reference on this device."""

from __future__ import annotations

import argparse


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "selftest",
        help="check every kernel against float64 on this device",
        description="Error and time of every stage; exit code 1 where an error exceeds its limit.",
    )
    parser.add_argument("--device", help="number or part of the name, see `clgs devices`")


def run(args: argparse.Namespace) -> int:
    """Run the checks; exit code 0, or 1 where one fails."""
    from rich.console import Console
    from rich.table import Table

    from clgs.opencl.device import Device
    from clgs.testing.selftest import selftest

    device = Device(args.device)
    table = Table("stage", "quantity", title=f"{device.name} ({device.specialisation})")
    for column in ("error", "limit", "ms", ""):
        table.add_column(column, justify="right")
    failures = 0
    for check in selftest(device):
        failures += not check.passed
        table.add_row(
            check.stage,
            check.quantity,
            f"{check.error:.2e}",
            f"{check.limit:.0e}",
            f"{check.milliseconds:.2f}",
            "ok" if check.passed else "FAIL",
        )
    Console().print(table)
    print("all checks passed" if not failures else f"{failures} checks failed")
    return 1 if failures else 0
