"""`clgs batch TABLE.toml -o RUNS`: many scenes, trained side by side or on many machines."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import add_cluster, add_device_name, named_path
from clgs.cli.tell import tell

if TYPE_CHECKING:
    from clgs.cluster.engine import Message
    from clgs.cluster.worker import Row


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.usage = "%(prog)s TABLE.toml -o RUNS [OPTION ...]"
    parser.description = (
        "Train the scenes of a table. Each [scene.NAME] has data, a folder relative to that of the "
        "table, and perhaps settings, named as in config.toml; [settings] are those of every "
        "scene. RUNS/NAME receives the run of a scene. The same command goes on after an "
        "interruption. Needs the extra clgs[distributed]."
    )
    add = parser.add_argument
    add("table", type=Path, metavar="TABLE.toml", help="the scenes and their settings")
    add("-o", "--output", type=named_path, required=True, metavar="RUNS", help="folder of the runs")
    add_cluster(parser)
    add_device_name(parser)


def run(args: argparse.Namespace) -> int:
    """Train what is not finished; the exit code is the largest of the scenes'."""
    from clgs.cluster.batch import train_scenes

    shown: dict[str, int] = {}

    def show_step(message: Message) -> None:
        """Print a line at every quarter of a run."""
        name, step, steps = message["run"], message["step"], message["steps"]
        if (quarter := 4 * step // steps) != shown.get(name, 0):
            shown[name] = quarter
            tell(f"{name}: step {step}/{steps}")

    def show_row(row: Row) -> None:
        """Print how a run ended."""
        if "error" in row:
            tell(f"clgs: error: {row['run']}: {row['error']}")
            return
        done = "is finished already" if row["was_finished"] else f"{row['train_seconds']:.0f} s"
        figures = f"PSNR {row['psnr']:.2f} dB, {row['bytes']:,} bytes, {row['anchors']:,} anchors"
        print(f"{row['run']}: {figures}; {done}", flush=True)

    try:
        rows = train_scenes(
            args.table,
            args.output,
            workers=args.workers,
            scheduler=args.scheduler,
            device=args.device,
            on_row=show_row,
            on_message=show_step,
        )
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; repeat the command to go on") from None
    return max((int(row["exit_code"]) for row in rows if "error" in row), default=0)
