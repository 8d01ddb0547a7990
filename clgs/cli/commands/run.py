"""`clgs run PHOTOS -o OUT`: from photos to a scene, a report and what one shows to others."""

from __future__ import annotations

import argparse

from clgs.cli.options.output import add_overwrite
from clgs.cli.options.view import named_path, photo_width, positive_int, seed
from clgs.cli.run.duration import duration

DESCRIPTION = """\
The whole way, each stage a command of clgs that is shown as it runs: find the poses of the photos
(`prepare`), train, encode, score the held-out views from the file alone, and write a web page,
ordinary 3-D Gaussians, a clip and a report. The plan is told first: resolution and steps are chosen
so that all of it fits --time on this device, unless --steps or --max-size say otherwise.

OUT receives data/ (if poses had to be found), run/, scene.clgs, scores.json, scene.html, scene.ply,
clip.mp4 (if the extra clgs[video] is installed) and report.html, which links to them."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.usage = "%(prog)s PHOTOS|VIDEO|DATA -o OUT [OPTION ...]"
    parser.description = DESCRIPTION
    add = parser.add_argument
    add("input", type=named_path, metavar="INPUT", help="folder of photos, video, or data set")
    add("-o", "--output", type=named_path, required=True, metavar="OUT", help="folder for all")
    add(
        "--time",
        type=duration,
        metavar="T",
        help="for everything, such as 90s, 5m or 1h (default: 10m)",
    )
    add("--steps", type=positive_int, metavar="N", help="of training (default: what T allows)")
    add(
        "--max-size",
        type=photo_width,
        metavar="PIXELS",
        help="reduce wider photos to this width (default: what T allows)",
    )
    add("--seed", type=seed, help="random seed (default: 0)")
    add("--device", help="number or part of the name, see `clgs devices`")
    add(
        "--resume",
        action="store_true",
        help="go on with a run that was interrupted, by its plan; start it if there is none yet",
    )
    add("--plan", action="store_true", help="only tell the plan")
    add_overwrite(parser, "what an earlier run of this command left in OUT")


def run(args: argparse.Namespace) -> int:
    """All stages; exit code 0, or that of the stage that failed."""
    from clgs.cli.notes import warnings_once
    from clgs.cli.run.job import Job

    try:
        with warnings_once():
            return Job(args).run()
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; repeat the command with --resume to go on") from None
