"""`clgs train DATA -o RUN`: photos with poses to a trained, quantised, encoded scene."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.output import add_overwrite
from clgs.cli.options.training import add_training_options, make_config
from clgs.cli.options.view import check_apart, named_path
from clgs.cli.tell import tell

if TYPE_CHECKING:
    from clgs.cli.progress import TrainingDisplay
    from clgs.cli.tensorboard import EventLog
    from clgs.train.run.session import Progress, Session


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
    add("--device", help="number or part of the name, see `clgs devices`")
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
        help="show the time of every stage and what each skip saved; writes profile.json (slower)",
    )
    add(
        "--tensorboard",
        action="store_true",
        help="write RUN/tensorboard/ as training goes on; needs the extra clgs[tensorboard]",
    )
    add_training_options(parser)


def run(args: argparse.Namespace) -> int:
    """Train; exit code 0."""
    from clgs.cli.progress import TrainingDisplay, print_summary
    from clgs.cli.tensorboard import EventLog, check_tensorboard
    from clgs.errors import UsageError
    from clgs.files import check_folder
    from clgs.memory import return_freed_memory
    from clgs.opencl.device import Device
    from clgs.train.run.finished_run import check_run_folder, check_same_data, finished_run
    from clgs.train.run.load import load_for
    from clgs.train.run.session import Session

    return_freed_memory()
    config = make_config(args)
    if args.tensorboard:
        check_tensorboard()
    check_folder(args.output)
    if (args.output / "checkpoint").is_file():
        raise UsageError(f"{args.output / 'checkpoint'}: is not a folder; remove it")
    check_apart(args.output, args.data)
    check_run_folder(args.output, args.resume, args.overwrite)
    if args.resume:
        check_same_data(args.output, args.data)
    device = Device(args.device)
    device.profile.enabled = args.profile
    dataset = load_for(config, args.data, args.output, tell)
    config = config.for_dataset(dataset.kind)
    if args.resume and (finished := finished_run(args.output, dataset, config)):
        print(f"{args.output}: is finished already, after {config.steps} steps; nothing is changed")
        print_summary(finished)
        return 0
    session = Session(dataset, args.output, config, device, resume=args.resume)
    try:
        with TrainingDisplay(config.steps, session.trainer.steps_done) as display:
            events = EventLog(args.output / "tensorboard") if args.tensorboard else None
            result = session.run(partial(_follow, display, events))
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; repeat the command with --resume to go on") from None
    if args.profile:
        _report_profile(session)
    _write_report(args)
    print_summary(result)
    return 0


def _follow(display: TrainingDisplay, events: EventLog | None, progress: Progress) -> None:
    """Show a step, and log it."""
    display.update(progress)
    if events is not None:
        events.update(progress)


def _write_report(args: argparse.Namespace) -> None:
    """The report, with the command that repeats the run: with --resume it would change nothing."""
    from clgs.export.run_report import RunStory, write_run_report

    command = args.command_line.replace(" --resume", "")
    write_run_report(args.output, RunStory(command, f"Trained on {args.data}."))


def _report_profile(session: Session) -> None:
    """Print the time by stage and what the skips saved; write both to profile.json."""
    from dataclasses import asdict

    from clgs.cli.progress import print_profile
    from clgs.files import write_json
    from clgs.train.quality.savings import savings

    rows = session.device.profile.rows()
    saved = savings(session.trainer)
    names = ("stage", "calls", "median_ms", "total_s")
    stages = [dict(zip(names, row, strict=True)) for row in rows]
    skips = [{**asdict(saving), "share": saving.share} for saving in saved]
    write_json(session.folder / "profile.json", {"stages": stages, "skips": skips})
    print_profile(rows, saved)
