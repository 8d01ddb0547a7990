"""`clgs bench`: speed, accuracy, growth of time and memory, and the codec; one module per kind."""

from __future__ import annotations

import argparse
import importlib

KINDS = ("step", "ops", "accuracy", "scaling", "codec", "gsplat")
"""Each is a module of ``clgs.lab.bench_commands`` with ``register(kinds)`` and ``run(args)``."""

SMALLER = {
    "step": "a smaller --size or fewer --gaussians need",
    "ops": "a smaller --size, fewer --gaussians or --elements need",
    "accuracy": "fewer or smaller --scenes, or a larger --downscale of --scene, need",
    "codec": "fewer --anchors, or smaller DATA with --levels-only, need",
    "gsplat": "a smaller --size or fewer --gaussians need",
    "scaling": "smaller --sizes or fewer --gaussians need",
}
"""What to change if memory is short."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command, its kinds and their options."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for kind in KINDS:
        importlib.import_module(f"clgs.lab.bench_commands.{kind}").register(kinds)


def run(args: argparse.Namespace) -> int:
    """Run the kind that was asked for; its exit code."""
    from clgs.errors import ClgsError, DeviceError, NoRoomError

    remedy = f"{SMALLER[args.kind]} less"
    try:
        code: int = importlib.import_module(f"clgs.lab.bench_commands.{args.kind}").run(args)
    except NoRoomError as error:
        raise DeviceError(f"{error.problem}; {remedy}") from error
    except MemoryError as error:
        raise ClgsError(f"out of memory ({error}); {remedy}") from error
    return code
