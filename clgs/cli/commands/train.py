"""`clgs train DATA -o RUN`: photos with poses to a trained, quantised, encoded scene."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import (
    add_cluster,
    add_device_name,
    add_overwrite,
    add_training_options,
    chosen,
    make_config,
    named_path,
)
from clgs.errors import UsageError

if TYPE_CHECKING:
    from clgs.train.run.session import Progress
    from clgs.workflow.train import TrainedRun

LEFT_OVER = 0.02
"""Share of a target size that may be left over without a word."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.usage = "%(prog)s DATA -o RUN [OPTION ...]"
    parser.description = (
        "Train a scene. RUN receives scene.clgs, scene.npz, config.toml, progress.csv, "
        "results.json, per_view.json, hashes.json, data.json, report.html, test/, "
        "preview.png, checkpoint/ and points-*.npz if points were triangulated. Of the "
        "options, (paper) names values of Voxel-GS, arXiv 2512.17528, and (code) those of its "
        "code."
    )
    add = parser.add_argument
    add("data", type=Path, metavar="DATA", help="Blender, transforms.json or COLMAP folder")
    add("-o", "--output", type=named_path, required=True, metavar="RUN", help="run folder")
    where = parser.add_mutually_exclusive_group()
    add_device_name(where)
    where.add_argument(
        "--devices",
        type=lambda names: names.split(","),
        default=[],
        metavar="A,B",
        help="several in its place that compute the same bits, see `clgs devices`: each looks at a "
        "view of every step, see --batch; the same one twice trains the same scene",
    )
    add(
        "--from",
        dest="start",
        type=named_path,
        metavar="RUN",
        help="go on from this finished run, with its settings unless other options are given; its "
        "steps count (default of --steps: twice as many)",
    )
    add(
        "--resume",
        action="store_true",
        help="continue an interrupted run from its checkpoint, with the same options; start it if "
        "there is none yet; leave a finished one as it is",
    )
    add_overwrite(parser, "a run in RUN")
    add(
        "--profile",
        action="store_true",
        help="show the time of every stage; writes profile.json (slower)",
    )
    add(
        "--tensorboard",
        action="store_true",
        help="write RUN/tensorboard/ as training goes on; needs the extra clgs[tensorboard]",
    )
    add(
        "--blocks",
        metavar="NxM",
        help="train the scene in N x M blocks that start from a coarse scene, learn one after the "
        "other or on --workers or --scheduler, and are merged; auto: as few as the memory of a "
        "worker allows, two at least",
    )
    add_cluster(
        parser, "processes on this machine that train blocks (default: this one does)", None
    )
    add_training_options(parser)


def run(args: argparse.Namespace) -> int:
    """Train, as a whole or in blocks; exit code 0."""
    from clgs.cli.display import Display
    from clgs.cli.tell import warnings_once
    from clgs.workflow.events import Event, TrainingProgress

    config = make_config(vars(args))
    alone = {"--from": args.start, "--devices": args.devices, "--profile": args.profile}
    for flag, given in {**alone, "--tensorboard": args.tensorboard}.items():
        if given and args.blocks is not None:
            raise UsageError(f"{flag}: not with --blocks; leave out one of both")
    if args.blocks is None and (args.workers is not None or args.scheduler is not None):
        raise UsageError("--workers, --scheduler: train blocks; add --blocks auto")
    if args.tensorboard and find_spec("tensorboard") is None:
        raise UsageError("--tensorboard: is not installed; pip install 'clgs[tensorboard]'")
    events = EventLog(args.output / "tensorboard") if args.tensorboard else None
    display = Display()
    own = ("start", "devices", "profile") if args.blocks is None else ("workers", "scheduler")
    options = chosen(vars(args), *own, "device", "resume", "overwrite")
    options["command"] = args.command_line.replace(" --resume", "")  # it would change nothing

    def follow(event: Event) -> None:
        display(event)
        if events is not None and isinstance(event, TrainingProgress):
            events.update(event.progress)

    options["on_event"] = follow
    try:
        with warnings_once(), display:
            if args.blocks is None:
                from clgs.workflow.train import train

                trained = train(args.data, args.output, config, **options)
            else:
                from clgs.cluster.block_run import train_in_blocks

                trained = train_in_blocks(args.data, args.output, config, args.blocks, **options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; repeat the command with --resume to go on") from None
    show(trained)
    return 0


def show(trained: TrainedRun) -> None:
    """Print the scores, the files, and the profile if there is one."""
    result, summary = trained.result, trained.result.summary
    if trained.was_finished:
        done = f"is finished already, after {trained.steps} steps; nothing is changed"
        print(f"{result.folder}: {done}")
    if trained.times:
        from rich.console import Console
        from rich.table import Table

        table = Table("stage", title="Time by stage")
        for column in ("calls", "median ms", "total s", "share"):
            table.add_column(column, justify="right")
        total = sum(seconds for *_, seconds in trained.times) or 1.0
        for name, calls, milliseconds, seconds in trained.times:
            share = f"{100 * seconds / total:.1f} %"
            table.add_row(name, str(calls), f"{milliseconds:.2f}", f"{seconds:.1f}", share)
        Console().print(table)
    in_training = f" ({summary['train_psnr']:.2f} in training)" if "train_psnr" in summary else ""
    split = "held-out" if summary["split"] == "test" else "training"
    print(
        f"{split} views: PSNR {summary['psnr']:.2f} dB{in_training}, SSIM {summary['ssim']:.4f}; "
        f"{summary['bytes']:,} bytes, {summary['anchors']:,} anchors, "
        f"{summary['train_seconds']:.0f} s"
    )
    missing = 1 - summary["bytes"] / (summary.get("target_size") or summary["bytes"])
    if missing > LEFT_OVER:
        print(
            f"the file is {100 * missing:.1f} % smaller than asked for: so short a run, or one "
            "with so few anchors, cannot fill it"
        )
    print(f"{result.folder / 'scene.clgs'}  {result.folder / 'results.json'}")


class EventLog:
    """Writes the progress for TensorBoard, at the steps at which the PSNR is measured."""

    def __init__(self, folder: Path) -> None:
        from tensorboard.summary import Writer

        self._writer = Writer(str(folder))

    def update(self, progress: Progress) -> None:
        """Write a step, if its PSNR was measured, and leave nothing in memory."""
        if progress.psnr is None:
            return
        result = progress.result
        values = {
            "loss/total": result.loss,
            "loss/l1": result.l1,
            "loss/ssim": result.ssim,
            "psnr/training views": progress.psnr,
            "size/anchors": result.anchors,
            "size/estimated bytes": progress.estimated_bytes,
        }
        for name, value in values.items():
            if value is not None:
                self._writer.add_scalar(name, float(value), result.step)
        self._writer.flush()
