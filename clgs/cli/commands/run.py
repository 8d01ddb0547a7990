"""`clgs run PHOTOS -o OUT`: from photos to a scene, a report and what one shows to others."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from clgs.cli.options import (
    add_device_name,
    add_masks,
    add_option,
    add_overwrite,
    chosen,
    duration,
    frame_size,
    named_path,
    photo_width,
    positive_int,
    seed,
)
from clgs.errors import UsageError
from clgs.train.config import TrainConfig, parse_word
from clgs.train.config.option import options_of

if TYPE_CHECKING:
    from clgs.workflow.runs.plan import TrainingPlan
    from clgs.workflow.runs.record import FinishedRun, RunPlan

TRAINING = ("size_lambda", "target_size", "exposure", "max_anchors", "background")
"""Settings of training that have options of their own."""

DESCRIPTION = """\
Find the poses of the photos (`prepare`), train, encode, score the held-out views from the file
alone, and write a web page, ordinary 3-D Gaussians, a clip and a report. Every stage shows the
command of clgs that does the same. The plan is shown first: resolution and steps are chosen so that
all of it fits --time on this device, unless --steps or --max-size say otherwise.

OUT receives data/ (if poses had to be found), run/, scene.clgs, scores.json, scene.html, scene.ply,
clip.mp4 (if the extra clgs[video] is installed) and report.html, which links to them."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.usage = "%(prog)s PHOTOS|VIDEO|DATA -o OUT [OPTION ...]"
    parser.description = DESCRIPTION
    add = parser.add_argument
    add("input", type=named_path, metavar="INPUT", help="folder of photos, video, or data set")
    add("-o", "--output", type=named_path, required=True, metavar="OUT", help="folder for all")
    help_time = "for everything, such as 90s, 5m or 1h30m (default: 10m); a number alone is seconds"
    add("--time", type=duration, metavar="T", help=help_time)
    add("--steps", type=positive_int, metavar="N", help="of training (default: what T allows)")
    add(
        "--max-size",
        type=photo_width,
        metavar="PIXELS",
        help="reduce wider photos to this width (default: what T allows)",
    )
    add("--seed", type=seed, help="random seed (default: 0)")
    add("--name", metavar="TITLE", help="of report and page (default: the photos' folder)")
    add_device_name(parser)
    add(
        "--resume",
        action="store_true",
        help="go on with a run that was interrupted, by its plan; start it if there is none yet",
    )
    add("--plan", action="store_true", help="only show the plan")
    add_overwrite(parser, "what an earlier run of this command left in OUT")
    clip = parser.add_argument_group("the clip (defaults: what the photos and a part of T allow)")
    clip.add_argument(
        "--clip",
        metavar="orbit|spiral|interpolate|F.json|none",
        help="where its camera goes, as of `clgs render --path` (default: orbit, or through the "
        "photos if they look outward)",
    )
    add_clip = clip.add_argument
    add_clip("--clip-time", type=duration, metavar="T", help="such as 10s")
    add_clip("--clip-size", type=frame_size, metavar="WxH", help="even numbers of pixels")
    training = parser.add_argument_group("training, as of `clgs train`")
    for name in TRAINING:
        add_option(training, options_of(TrainConfig)[name])
    add_masks(training, "object if all photos have masks that leave something in the middle")
    training.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any other setting that the plan leaves open; may be given several times",
    )


def run(args: argparse.Namespace) -> int:
    """Do all stages, or show the plan; exit code 0, or that of the last export that failed."""
    from clgs.cli.display import Display
    from clgs.cli.main import complain
    from clgs.cli.tell import warnings_once
    from clgs.workflow.events import Event, RunStage, StageFailure, StageRecord
    from clgs.workflow.runs.run import plan_run
    from clgs.workflow.runs.run import run as run_all

    code, display = 0, Display()

    def follow(event: Event) -> None:
        nonlocal code
        match event:
            case RunStage(stage, text):
                display.stop()
                print(f"\n[{stage}] {text}", flush=True)
            case StageRecord(record):
                display.stop()
                _show(record)
            case StageFailure(_, error):
                display.stop()
                code = complain(error)
            case _:
                display(event)

    from clgs.workflow.runs.plan import Presentation

    known = options_of(TrainConfig)
    settings = {name: value for name, value in vars(args).items() if name in known}
    for name in ("steps", "max_size", "seed"):
        del settings[name]
    settings |= dict(map(parse_word, args.set))
    options = {"seconds": args.time, "settings": settings}
    options |= chosen(vars(args), "steps", "max_size", "seed", "device")
    options["shown"] = Presentation(args.name, args.clip, args.clip_time, args.clip_size)
    done: RunPlan | FinishedRun
    try:
        with warnings_once(), display:
            if args.plan:
                if args.resume and args.overwrite:
                    raise UsageError("--resume and --overwrite contradict each other; give one")
                done = plan_run(args.input, args.output, on_event=follow, **options)
            else:
                options |= chosen(vars(args), "resume", "overwrite")
                done = run_all(args.input, args.output, on_event=follow, **options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; repeat the command with --resume to go on") from None
    _show(done)
    return code


def _show(record: object) -> None:
    """Print a plan, the box of the finished run, or the record of a stage as its command does."""
    from clgs.cli.commands import encode, eval, export, prepare, render, train
    from clgs.workflow.pictures import Clip
    from clgs.workflow.prepare import PreparedData
    from clgs.workflow.runs.plan import TrainingPlan
    from clgs.workflow.runs.record import FinishedRun, RunPlan
    from clgs.workflow.smaller import EncodedFile
    from clgs.workflow.train import TrainedRun
    from clgs.workflow.views import Evaluation

    show: dict[type, Callable[[Any], None]] = {
        RunPlan: _show_plan,
        TrainingPlan: lambda plan: print(f"training: {_training(plan)}"),
        PreparedData: prepare.show,
        TrainedRun: train.show,
        EncodedFile: lambda made: encode.show(made.path, made.size, made.anchors),
        Evaluation: eval.show,
        Clip: render.show,
        FinishedRun: _show_box,
    }
    show.get(type(record), export.show)(record)


def _show_plan(plan: RunPlan) -> None:
    from clgs.workflow.runs.plan import LATE
    from clgs.workflow.runs.record import in_words

    given, photos, training = plan.input, plan.input.photos, plan.training
    kind = "data set" if given.posed else "frames" if given.video else "photos"
    print(f"{given.path}: {kind}, {photos.count} of {photos.width} x {photos.height} pixels")
    if photos.masks:
        print(photos.masks_in_words())
    preparing = f"about {in_words(training.prepare_seconds)}"
    if not given.posed and not training.prepare_seconds:
        print("poses:    are there")
    elif not given.posed:
        tested = (
            "not tested, for lack of time" if plan.hurry else "tested by a second reconstruction"
        )
        print(f"poses:    {preparing}, {tested}")
    if given.pointless:
        print(f"points:   {preparing}")
    print(f"training: {_training(training)}")
    print(f"the rest: about {in_words(training.other_seconds)}: scores, page, Gaussians, clip")
    if (clip := training.clip).frames:
        print(
            f"clip:     {clip.frames / clip.fps:g} s at {clip.fps:g} per second of "
            f"{clip.width} x {clip.height} pixels, about {in_words(clip.seconds)} of these"
        )
    too_long = training.seconds > LATE * plan.allowed
    late = f", more than the {in_words(plan.allowed)} of --time" if too_long else ""
    whole = f"about {in_words(training.seconds)} on {plan.device}{late}"
    print(f"in all:   {whole}", flush=True)


def _training(plan: TrainingPlan) -> str:
    from clgs.workflow.runs.record import in_words

    return (
        f"{plan.steps:,} steps on photos at most {plan.max_size} wide, "
        f"about {in_words(plan.train_seconds)}"
    )


def _show_box(done: FinishedRun) -> None:
    from rich.console import Console
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    from clgs.cli.tell import counted
    from clgs.workflow.runs.record import in_words
    from clgs.workflow.runs.stages import REPORT

    scores, seconds = done.scores, done.seconds
    stages = "  ".join(f"{name} {one:.0f}" for name, one in seconds.items())
    split = "held-out view" if scores["split"] == "test" else "training view"
    rows = {
        "photos": done.photos,
        "PSNR": f"{scores['psnr']:.2f} dB on {counted(scores['views'], split)}, from the file",
        "SSIM": f"{scores['ssim']:.4f}",
        "bytes": f"{scores['bytes']:,} for {scores['anchors']:,} anchors",
        "time": f"{in_words(sum(seconds.values()))}; seconds: {stages}",
        "look at": str(done.folder / REPORT),
    }
    table = Table.grid(padding=(0, 2))
    for name, value in rows.items():
        table.add_row(Text(name, style="dim"), Text(value))
    Console().print(Panel(table, title="clgs run: done", border_style="green", expand=False))
    if done.sketch:
        print(done.sketch)
