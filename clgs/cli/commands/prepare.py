"""``clgs prepare``: a folder of photos, or a video, to a data set with camera poses."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from clgs.cli.options.output import add_overwrite
from clgs.cli.options.view import named_path, positive_int, seed

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def register(subparsers: Subparsers) -> None:
    """Add the command to the parser of ``clgs``."""
    parser = subparsers.add_parser(
        "prepare",
        help="find the camera poses of a folder of photos, or of a video",
        description="Structure from motion: writes DATA/images (undistorted) and DATA/sparse/0, "
        "and DATA/masks if photos have masks (PHOTOS/masks/NAME.png, black where a photo is not "
        "to be used, or an alpha channel).",
    )
    parser.add_argument(
        "photos",
        metavar="PHOTOS",
        help="folder of photos (JPEG, PNG, WebP, HEIC), or a video",
    )
    parser.add_argument(
        "--frames",
        type=positive_int,
        metavar="N",
        help="take so many sharp, evenly spread frames of a video (default: 100)",
    )
    parser.add_argument(
        "-o", "--output", type=named_path, metavar="DATA", required=True, help="new folder"
    )
    parser.add_argument("--seed", type=seed, default=0, help="random seed (default: %(default)s)")
    add_overwrite(parser, "DATA if an earlier run of this command made it (default: refuse)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prepare ``args.photos`` into ``args.output`` and print one line; returns the exit code."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from clgs.data.sfm.prepare import STAGES, prepare

    start = time.perf_counter()
    columns = (
        TextColumn("{task.description:<10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    quiet = not console.is_terminal  # a bar that is not redrawn leaves empty lines
    with Progress(*columns, console=console, transient=True, disable=quiet) as progress:
        task = progress.add_task(STAGES[0], total=len(STAGES))

        def on_stage(stage: str) -> None:
            progress.update(task, description=stage, completed=STAGES.index(stage))

        summary = prepare(
            args.photos, args.output, args.seed, on_stage, args.overwrite, args.frames
        )
    seconds = time.perf_counter() - start
    print(
        f"{args.output}: registered {summary.registered} of {summary.total} photos, "
        f"{summary.points} points, reprojection error {summary.error:.2f} px, {seconds:.0f} s"
    )
    return 0
