"""`clgs bench`: speed, accuracy and growth of time and memory; one module a kind."""

from __future__ import annotations

import argparse
import importlib

KINDS = ("step", "ops", "accuracy", "scaling")
"""Each is a module ``clgs.cli.bench_<kind>`` with ``register(kinds)`` and ``run(args)``."""


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command, its kinds and their options."""
    parser = subparsers.add_parser("bench", help="measure speed and accuracy on this device")
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for kind in KINDS:
        importlib.import_module(f"clgs.cli.bench_{kind}").register(kinds)


def run(args: argparse.Namespace) -> int:
    """Run the kind that was asked for; its exit code."""
    code: int = importlib.import_module(f"clgs.cli.bench_{args.kind}").run(args)
    return code
