"""``clgs prepare``: a folder of photos, or a video, to a data set with camera poses."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from clgs.cli.options import (
    add_device_name,
    add_overwrite,
    chosen,
    named_path,
    photo_width,
    positive_int,
    seed,
)

if TYPE_CHECKING:
    from clgs.workflow.prepare import PreparedData

NAMED = 20
"""The most photos in doubt that are listed on the terminal."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Structure from motion: writes DATA/images (undistorted), DATA/sparse/0, a verdict on "
        "every photo in DATA/report.html and DATA/report.json, and DATA/masks if photos have "
        "masks (PHOTOS/masks/NAME.png, black where a photo is not to be used, or an alpha "
        "channel)."
    )
    add = parser.add_argument
    add("photos", metavar="PHOTOS", help="folder of photos (JPEG, PNG, WebP, HEIC), or a video")
    add(
        "--frames",
        type=positive_int,
        metavar="N",
        help="take this many sharp, evenly spread frames of a video (default: 100)",
    )
    add("-o", "--output", type=named_path, metavar="DATA", required=True, help="new folder")
    add("--seed", type=seed, default=0, help="random seed (default: %(default)s)")
    add("--quick", action="store_true", help="fewer features, one mapper, poses not tested")
    add(
        "--drop-doubtful",
        action="store_true",
        help="leave out photos whose poses are in doubt (default: they are named, and stay)",
    )
    add(
        "--max-size",
        type=photo_width,
        default=0,
        metavar="PIXELS",
        help="write photos that are wider at about this width (default: as they are)",
    )
    add(
        "--equirectangular",
        action="store_true",
        help="cut photos or frames that show the whole sphere into pinhole views (default: those "
        "photos that say so, by XMP data)",
    )
    add(
        "--poses",
        type=named_path,
        metavar="KNOWN",
        help="data set of any program, or one of its files: its poses of the photos are refined "
        "instead of found",
    )
    add(
        "--continue",
        dest="continued",
        type=named_path,
        metavar="OLD",
        help="data set to whose photos and poses PHOTOS are added",
    )
    add_device_name(parser)
    add_overwrite(parser, "DATA if an earlier run of this command made it (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Find the poses and print the verdict; exit code 0."""
    from clgs.cli.display import Display
    from clgs.workflow.prepare import prepare_data

    names = "seed", "quick", "frames", "drop_doubtful", "max_size", "device", "overwrite"
    options = chosen(vars(args), *names, "equirectangular", "poses", "continued")
    try:
        with Display() as display:
            made = prepare_data(args.photos, args.output, on_event=display, **options)
    except KeyboardInterrupt as error:
        notes = getattr(error, "__notes__", [])
        raise KeyboardInterrupt("".join(f"; {note}" for note in notes)) from None
    show(made)
    return 0


def show(made: PreparedData) -> None:
    """Print the verdict."""
    from clgs.poses.find import shown
    from clgs.poses.verdict import DOUBTFUL, LEFT_OUT

    verdict = made.verdict
    print(
        f"{made.folder}: registered {verdict.registered} of {verdict.total} photos, "
        f"{verdict.points:,} points, reprojection error {verdict.error:.2f} px, "
        f"track length {verdict.track_length:.1f}, {made.seconds:.0f} s"
    )
    print(verdict.sure)
    for note in verdict.notes:
        print(note)
    doubted = [*verdict.of(LEFT_OUT), *verdict.of(DOUBTFUL)]
    for photo in doubted[:NAMED]:
        print(f"  {shown(photo.name)}: {photo.status}: {'; '.join(photo.reasons)}; {photo.remedy}")
    if len(doubted) > NAMED:
        print(f"  and {len(doubted) - NAMED} more")
    print(made.page)
