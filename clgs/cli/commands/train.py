"""`clgs train DATA -o RUN`: photos with poses to a trained, quantised, encoded scene."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.view import add_accuracy_options, add_memory_option, named_path, positive_int

if TYPE_CHECKING:
    from clgs.train.config import TrainConfig
    from clgs.train.run.session import Session


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "train",
        help="train a scene from photos with poses",
        description="Train a scene. RUN receives config.toml, progress.csv, scene.clgs, "
        "results.json, per_view.json, hashes.json, test/ and preview.png.",
    )
    _add_run_options(parser)
    _add_method_options(parser)


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("data", type=Path, help="Blender, transforms.json or COLMAP folder")
    add("-o", "--output", type=named_path, required=True, metavar="RUN", help="run folder")
    add(
        "--preset",
        choices=("quick", "paper"),
        help="quick: 3,000 steps; paper: published constants and the data's own units",
    )
    add(
        "--steps",
        type=positive_int,
        help="training steps; scales the start of statistics, the growth window, the quantisation "
        "switch and the learning-rate horizons, and in short runs the learning rates of features "
        "and offsets (default: 30000)",
    )
    add("--seed", type=int, default=0, help="of all random choices (default: 0)")
    add("--device", help="number or part of the name, see `clgs devices`")
    add(
        "--downscale",
        type=positive_int,
        default=1,
        metavar="N",
        help="reduce the photos N times (default: 1)",
    )
    add(
        "--resume",
        action="store_true",
        help="continue an interrupted run from its checkpoint, with the same options; start it "
        "where there is none yet; leave a finished one as it is",
    )
    add_accuracy_options(parser, "parity")
    add_memory_option(parser)
    add(
        "--profile",
        action="store_true",
        help="show the time of every stage and what each skip saved; writes profile.json (slower)",
    )


def _add_method_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--background",
        choices=("black", "white", "random"),
        default="black",
        help="behind transparent photos and unfinished pixels (default: black)",
    )
    add(
        "--proxy",
        choices=("channel", "pooled"),
        help="rate proxy: one Laplace model a channel (default), or the paper's pooled form "
        "(default of --preset paper)",
    )
    add(
        "--adam",
        choices=("dense", "visible"),
        help="whether every anchor moves at every step (default), or those that got a gradient",
    )
    add(
        "--mlp",
        choices=("quantized", "float32"),
        help="whether the weights of the MLPs are rounded in the last fifth of the steps (default: "
        "12 KB of the file), or stay as they are (46 KB)",
    )
    add(
        "--coarse-to-fine",
        action=argparse.BooleanOptionalAction,
        help="train on reduced photos first: a quarter of the size, then half",
    )
    add(
        "--loss-weights",
        type=float,
        nargs=2,
        metavar=("L1", "SSIM"),
        default=(0.8, 0.2),
        help="weights of L1 and of 1 - SSIM (default: 0.8 0.2)",
    )
    add(
        "--volume-weight",
        type=float,
        metavar="W",
        help="weight of the volume term (default: 0.01 on photos, 0 on Blender scenes)",
    )


def run(args: argparse.Namespace) -> int:
    """Train; exit code 0."""
    from clgs.cli.progress import TrainingDisplay, print_summary
    from clgs.data.dataset import load_dataset
    from clgs.errors import DataError, UsageError
    from clgs.files import check_folder
    from clgs.opencl.device import Device
    from clgs.train.run.finished_run import finished_run
    from clgs.train.run.session import Session

    config = make_config(args)
    check_folder(args.output)
    if (args.output / "checkpoint").is_file():
        raise UsageError(f"{args.output / 'checkpoint'}: is not a folder; remove it")
    if args.output.exists() and args.data.exists() and args.output.samefile(args.data):
        raise UsageError(f"{args.output}: is the folder of the photos; name another with -o")
    if not args.resume and (args.output / "config.toml").exists():
        raise DataError(f"{args.output}: holds a run already; add --resume or name another folder")
    device = Device(args.device)
    device.profile.enabled = args.profile
    dataset = load_dataset(
        args.data,
        downscale=args.downscale,
        preset_units=not config.normalize,
        cache=args.output,
        seed=args.seed,
        on_stage=partial(print, file=sys.stderr, flush=True),
    )
    config = config.for_dataset(dataset.kind)
    if args.resume and (finished := finished_run(args.output, dataset, config)):
        print(f"{args.output}: is finished already, after {config.steps} steps; nothing is changed")
        print_summary(finished)
        return 0
    session = Session(dataset, args.output, config, device, resume=args.resume)
    with TrainingDisplay(config.steps, session.trainer.steps_done) as display:
        result = session.run(display.update)
    if args.profile:
        _report_profile(session)
    print_summary(result)
    return 0


def _report_profile(session: Session) -> None:
    """Print the time by stage and what the skips saved; write both to profile.json."""
    from dataclasses import asdict

    from clgs.cli.progress import print_profile
    from clgs.train.quality.savings import savings
    from clgs.train.run.session import write_json

    rows = session.device.profile.rows()
    saved = savings(session.trainer)
    names = ("stage", "calls", "median_ms", "total_s")
    stages = [dict(zip(names, row, strict=True)) for row in rows]
    skips = [{**asdict(saving), "share": saving.share} for saving in saved]
    write_json(session.folder / "profile.json", {"stages": stages, "skips": skips})
    print_profile(rows, saved)


def make_config(args: argparse.Namespace) -> TrainConfig:
    """The configuration that the options describe, not yet resolved for a dataset."""
    from dataclasses import replace

    from clgs.train.config import preset

    config = preset(args.preset or "default")
    if args.steps is not None:
        config = config.scaled(args.steps)
    given = {
        "seed": args.seed,
        "background": args.background,
        "l1_weight": args.loss_weights[0],
        "ssim_weight": args.loss_weights[1],
    }
    names = (
        "volume_weight",
        "proxy",
        "accuracy",
        "smallest_anchor",
        "coarse_to_fine",
        "adam",
        "mlp",
    )
    optional = {name: getattr(args, name) for name in (*names, "mlp", "max_memory")}
    given |= {name: value for name, value in optional.items() if value is not None}
    return replace(config, **given)
