#!/usr/bin/env python3
"""What a GPU with warps of 32 lanes would have to do for a training step, counted without a GPU.

    scripts/gpu_counts/counts.py record FILE STATE [--source DIR]
    scripts/gpu_counts/counts.py table FILE
    scripts/gpu_counts/counts.py kernels FILE STATE
    scripts/gpu_counts/counts.py scaling FILE STATE
    scripts/gpu_counts/counts.py lines [--source DIR]

``record`` runs a step of small synthetic scenes in the kernels' form for GPUs under Oclgrind, with
a plugin that counts, and the scenes of ``clgs bench`` on the usual device for their sizes; it
replaces STATE ("before", "after") in FILE. ``table`` compares the states of FILE, stage by stage,
with counts scaled to these sizes and an estimate of the time on a card; ``kernels`` has a line for
each kernel, ``scaling`` shows how well counts scale from scene to scene, ``lines`` the lines of
the source that cost most. DIR: the checkout that is counted, set up; this one by default.

Estimates are lower bounds that no card has confirmed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import lines
import measure
import oclgrind
import table

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """Parse the arguments, run."""
    args = arguments()
    try:
        return run(args)
    except (OSError, ValueError, KeyError, TypeError, subprocess.CalledProcessError) as error:
        named = getattr(args, "file", getattr(args, "source", ""))
        wanted = "FILE is what `record` wrote, --source a checkout that is set up"
        told = f"{type(error).__name__}: {error}"
        print(f"gpu_counts: {named}: {told}; {wanted}", file=sys.stderr)
        return 1


def run(args: argparse.Namespace) -> int:
    """Do what was asked for."""
    if args.action in ("record", "lines") and (lacks := oclgrind.missing()):
        print(f"gpu_counts: needs {', '.join(lacks)}; install it", file=sys.stderr)
        return 1
    if args.action == "record":
        if not (args.source / "kernels_cl").is_dir():
            raise FileNotFoundError(f"{args.source}: no checkout of clgs")
        if not args.file.parent.is_dir():
            raise FileNotFoundError(f"{args.file.parent}: no such folder")
        known = read(args.file) if args.file.exists() else {}
        known[args.state] = measure.state(args.source.resolve())
        text = json.dumps(known, indent=1, sort_keys=True)
        args.file.write_text(text + "\n", encoding="utf-8")
    elif args.action == "lines":
        print("\n".join(lines.worst(args.source.resolve())))
    elif args.action == "table":
        known = read(args.file)
        states = {name: known[name] for name in sorted(known, reverse=True)}
        for bench in measure.BENCHES:
            print(f"{bench}, {table.ARROW.join(states)}:\n\n{table.stages(states, bench)}\n")
    else:
        show(args, read(args.file)[args.state])
    return 0


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    actions = parser.add_subparsers(dest="action", required=True)
    for name in ("record", "table", "kernels", "scaling", "lines"):
        action = actions.add_parser(name)
        if name != "lines":
            action.add_argument("file", type=Path)
        if name in ("record", "kernels", "scaling"):
            action.add_argument("state", choices=("before", "after"))
        if name in ("record", "lines"):
            action.add_argument("--source", type=Path, default=ROOT)
    return parser.parse_args()


def show(args: argparse.Namespace, state: dict[str, Any]) -> None:
    """A table of one state."""
    if args.action == "scaling":
        print("\n".join(table.scaling(state)))
        return
    for bench in measure.BENCHES:
        print(f"{bench}:\n\n" + "\n".join(table.by_kernel(state, bench)) + "\n")


def read(file: Path) -> dict[str, Any]:
    """What ``record`` wrote."""
    return dict(json.loads(file.read_text(encoding="utf-8")))


if __name__ == "__main__":
    sys.exit(main())
