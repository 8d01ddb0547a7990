#!/usr/bin/env python3
"""What a GPU with warps of 32 lanes would have to do for a training step, counted without a GPU.

    scripts/gpu_counts/counts.py {record,table,kernels} FILE
    scripts/gpu_counts/counts.py lines

``record`` runs a step of small synthetic scenes in the kernels' form for GPUs under Oclgrind, with
a plugin that counts, and the scenes of ``clgs bench`` on the usual device for their sizes. Then
``table`` has a line for each stage, with counts scaled to these sizes and an estimate of the time
on a card, and ``kernels`` one for each kernel. ``lines`` shows those of the source that cost most.

Estimates are lower bounds that no card has confirmed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import measure
import oclgrind
import table


def main() -> int:
    """Parse the arguments and run; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    actions = parser.add_subparsers(dest="action", required=True)
    for name in ("record", "table", "kernels", "lines"):
        action = actions.add_parser(name)
        if name != "lines":
            action.add_argument("file", type=Path)
    args = parser.parse_args()
    try:
        return run(args)
    except (OSError, ValueError, KeyError, TypeError, subprocess.CalledProcessError) as error:
        problem = f"{getattr(args, 'file', '')}: {type(error).__name__}: {error}"
        print(f"gpu_counts: {problem}; FILE is what `record` wrote", file=sys.stderr)
        return 1


def run(args: argparse.Namespace) -> int:
    """Do what was asked for; the exit code."""
    if args.action in ("record", "lines") and (lacks := oclgrind.missing()):
        print(f"gpu_counts: needs {', '.join(lacks)}; install it", file=sys.stderr)
        return 1
    if args.action == "record":
        if not args.file.parent.is_dir():
            raise FileNotFoundError(f"{args.file.parent}: no such folder")
        text = json.dumps(measure.state(), indent=1, sort_keys=True)
        args.file.write_text(text + "\n", encoding="utf-8")
        return 0
    if args.action == "lines":
        print("\n".join(measure.worst_lines()))
        return 0
    state = dict(json.loads(args.file.read_text(encoding="utf-8")))
    shown = table.by_stage if args.action == "table" else table.by_kernel
    for bench in measure.BENCHES:
        print(f"{bench}:\n\n" + "\n".join(shown(state, bench)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
