#!/usr/bin/env python3
"""Train a table of scenes and settings, as tasks on dask.distributed, and write the results.

What is finished is read and not trained again, so the command may be interrupted and repeated; a
run that was interrupted goes on from its newest checkpoint. OUTPUT/runs holds a folder a run.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from reproduce.baseline import read_baseline
from reproduce.report import write_report
from reproduce.results import read_results
from reproduce.table import Entry, Table, chosen, entries, jobs, read_table, run_folder
from reproduce.worker import run_job, stored_row

from clgs import __version__
from clgs.cli.options import add_cluster, positive_int
from clgs.cluster.engine import connected, require_distributed, run_tasks
from clgs.cluster.worker import Row
from clgs.errors import ClgsError, DataError, explain
from clgs.files import check_folder
from clgs.lab.figures import require_pyplot

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).resolve().parent / "reproduce" / "default.toml"
DATA = Path(os.environ.get("CLGS_SHARED_DATA", ROOT.parent / "shared" / "data"))


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(prog="reproduce", description=__doc__)
    add = parser.add_argument
    add(
        "--table",
        type=Path,
        default=TABLE,
        metavar="FILE",
        help="what to train (default: %(default)s)",
    )
    add(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help="train only an experiment or a scene of the table; may be given several times",
    )
    add(
        "--steps",
        type=positive_int,
        metavar="N",
        help="of every run, in place of the table's: to try",
    )
    add(
        "--data",
        type=Path,
        default=DATA,
        metavar="FOLDER",
        help="of the scenes (default: %(default)s)",
    )
    add(
        "--output",
        type=Path,
        default=Path("build/reproduce"),
        metavar="FOLDER",
        help="of the runs; all machines must see it under the same name (default: %(default)s)",
    )
    add(
        "--report",
        type=Path,
        metavar="FOLDER",
        help="receives results.md, results.json and results/ (default: OUTPUT)",
    )
    add(
        "--baseline",
        type=Path,
        metavar="FILE",
        help="results.json of another state, for BD-rates",
    )
    add("--note", default="", metavar="TEXT", help="a sentence for the head of the page")
    add_cluster(parser)
    return parser.parse_args(argv)


def run(args: argparse.Namespace) -> int:
    """Train what is missing and write the report; the exit code.

    Raises:
        ClgsError: what is asked for cannot be done; nothing is trained then.
    """
    require_distributed()
    require_pyplot()
    report = args.report or args.output
    check_folder(args.output)
    check_folder(report)
    if not args.data.is_dir():
        raise DataError(f"{args.data}: no such folder; name that of the scenes by --data")
    baseline = read_baseline(args.baseline) if args.baseline else []
    table = read_table(args.table)
    everything = entries(table, args.steps)
    failed = train(args, table, chosen(table, args.only, everything))
    results = read_results(table, everything, args.output)
    made = write_report(report, results, args.output, command(args), baseline, args.note)
    missing = len({one.run for one in results.missing})
    print(f"{made[0]}: {len(results.rows())} runs, {missing} missing")
    return max((int(row["exit_code"]) for row in failed), default=0)


def train(args: argparse.Namespace, table: Table, wanted: list[Entry]) -> list[Row]:
    """Train the runs of some entries that are not finished; the rows of those that failed."""
    facts = {"state": state(), "workers": "cluster" if args.scheduler else args.workers}
    waiting = [
        job
        for job in jobs(table, wanted, args.data, args.output, facts)
        if stored_row(run_folder(args.output, job["run"]), job["run"]) is None
    ]
    if not waiting:
        return []
    names = {
        one.run: " ".join(filter(None, (one.scene, one.experiment, one.label, f"seed {one.seed}")))
        for one in reversed(wanted)
    }
    shown: dict[str, int] = {}
    ended: list[Row] = []

    def show_step(message: dict[str, Any]) -> None:
        """Print a line at every quarter of a run."""
        run, step, steps = message["run"], message["step"], message["steps"]
        if (quarter := 4 * step // steps) != shown.get(run):
            shown[run] = quarter
            print(f"{names[run]}: step {step}/{steps}", file=sys.stderr, flush=True)

    def show_row(row: Row) -> None:
        """Print how a run ended."""
        ended.append(row)
        name = names[row["run"]]
        if "error" in row:
            print(f"reproduce: {name}: {row['error']}", file=sys.stderr, flush=True)
            return
        figures = f"{row['psnr']:.2f} dB, {row['bytes']:,} bytes, {row['seconds']:.0f} s"
        done = f"{len(ended)} of {len(waiting)}"
        print(f"{name}: {figures}; {done}", file=sys.stderr, flush=True)

    with connected(args.workers, args.scheduler) as client:
        rows = run_tasks(client, run_job, waiting, args.output / "kernels", show_row, show_step)
    return [row for row in rows if "error" in row]


def state() -> str:
    """The commit of this checkout, marked if files have changed since; else the version."""
    words = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return __version__
    return done.stdout.strip()


def command(args: argparse.Namespace) -> str:
    """What makes the report again, but for the names of folders."""
    words = ["scripts/reproduce.py"]
    if args.table != TABLE:
        words += ["--table", args.table.name]
    if args.steps:
        words += ["--steps", str(args.steps)]
    if args.baseline:
        words += ["--baseline", args.baseline.name]
    return shlex.join(words)


def main(argv: list[str] | None = None) -> int:
    """Run the command; the exit code."""
    args = parse(argv)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return run(args)
    except KeyboardInterrupt:
        print("reproduce: interrupted; the same command goes on", file=sys.stderr)
        return 130
    except (ClgsError, OSError) as error:
        message, code = explain(error)
        print(f"reproduce: error: {message}", file=sys.stderr)
        return code
    finally:
        signal.signal(signal.SIGTERM, before)


if __name__ == "__main__":
    sys.exit(main())
