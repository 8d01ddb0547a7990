"""``clgs prepare``: a folder of photos, or a video, to a data set with camera poses."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.output import add_overwrite
from clgs.cli.options.view import named_path, positive_int, seed

if TYPE_CHECKING:
    from clgs.poses.judging.verdict import PhotoVerdict, Verdict

PAGE = "report.html"
NAMED = 20
"""Of the photos in doubt, at most so many are listed on the terminal."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command to the parser of ``clgs``."""
    parser.description = (
        "Structure from motion: writes DATA/images (undistorted), DATA/sparse/0, a verdict on "
        "every photo in DATA/report.html and DATA/report.json, and DATA/masks if photos have "
        "masks (PHOTOS/masks/NAME.png, black where a photo is not to be used, or an alpha "
        "channel)."
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
    parser.add_argument(
        "--quick",
        action="store_true",
        help="fewer features, one mapper, poses not tested",
    )
    parser.add_argument(
        "--drop-doubtful",
        action="store_true",
        help="leave out photos whose poses are in doubt (default: they are named, and stay)",
    )
    add_overwrite(parser, "DATA if an earlier run of this command made it (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Prepare ``args.photos`` into ``args.output`` and print the verdict; returns the exit code."""
    from clgs.cli.stages import StageDisplay
    from clgs.export.poses_page import write_poses_page
    from clgs.poses.prepare import Doubts, prepare

    start = time.perf_counter()
    with StageDisplay() as display:
        verdict = prepare(
            args.photos,
            args.output,
            args.seed,
            display.update,
            overwrite=args.overwrite,
            quick=args.quick,
            frames=args.frames,
            doubts=Doubts(None if args.quick else _short_training, args.drop_doubtful),
        )
    write_poses_page(args.output / PAGE, args.output, verdict)
    _print_verdict(args.output, verdict, time.perf_counter() - start)
    return 0


def _short_training(data: Path, on_step: Callable[[int, int], None]) -> dict[str, float]:
    from clgs.opencl.device import Device
    from clgs.train.quality.pose_check import check_poses

    return check_poses(data, Device(), on_step)


def _print_verdict(output: Path, verdict: Verdict, seconds: float) -> None:
    from clgs.poses.judging.verdict import DOUBTFUL, LEFT_OUT

    print(
        f"{output}: registered {verdict.registered} of {verdict.total} photos, "
        f"{verdict.points:,} points, reprojection error {verdict.error:.2f} px, "
        f"track length {verdict.track_length:.1f}, {seconds:.0f} s"
    )
    print(verdict.sure)
    doubted = [*verdict.of(LEFT_OUT), *verdict.of(DOUBTFUL)]
    for photo in doubted[:NAMED]:
        print(_line(photo))
    if len(doubted) > NAMED:
        print(f"  and {len(doubted) - NAMED} more")
    print(f"{output / PAGE}")


def _line(photo: PhotoVerdict) -> str:
    name = photo.name if photo.name.isprintable() else repr(photo.name)
    return f"  {name}: {photo.status}: {'; '.join(photo.reasons)}; {photo.remedy}"
