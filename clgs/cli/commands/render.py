"""`clgs render SCENE --data DATA -o DIR` or `--path PATH -o clip.mp4`: pictures of a scene."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from clgs.cli.options import (
    add_overwrite,
    add_view_options,
    chosen,
    frame_size,
    named_path,
    number_within,
    positive_int,
    view_options,
)
from clgs.workflow.options import FPS, FRAMES, SIZE, UPS, PathOptions, refuse

if TYPE_CHECKING:
    from clgs.workflow.pictures import Clip

DESCRIPTION = """\
Render the views of a data set as PNG files, or a clip along a path.

SCENE is a run folder, a .clgs file of `clgs train` or `clgs pack`, or an ordinary 3DGS PLY file,
whose coordinates are those of its data set."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = DESCRIPTION
    add_view_options(parser)
    parser.add_argument(
        "-o", "--output", type=named_path, required=True, metavar="DIR|F.mp4", help="new pictures"
    )
    add_overwrite(parser, "the video, or pictures in DIR (default: refuse)")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--depth",
        dest="kind",
        action="store_const",
        const="depth",
        default="color",
        help="pictures of depth, near ones light; in a folder also NAME.npy, the depths in the "
        "data set's units (float32)",
    )
    kind.add_argument(
        "--opacity",
        dest="kind",
        action="store_const",
        const="opacity",
        help="pictures of opacity: white where nothing behind the scene shows through",
    )
    clip = parser.add_argument_group("a clip along a path")
    clip.add_argument(
        "--path",
        metavar="orbit|spiral|interpolate|F.json",
        help="render a clip: around the scene, on small circles before it, through the training "
        "photos, or along a camera path in nerfstudio's form; -o is an .mp4 file (extra "
        "clgs[video]) or a folder for PNG files",
    )
    clip.add_argument(
        "--frames", type=positive_int, metavar="N", help=f"(default: {FRAMES}, or those of F.json)"
    )
    clip.add_argument(
        "--fps",
        type=number_within(0.1, 1000, "from 0.1 to 1000"),
        metavar="X",
        help=f"frames per second (default: {FPS:g}, or F.json's)",
    )
    clip.add_argument(
        "--size",
        type=frame_size,
        metavar="WxH",
        help="pixels (default: of the photos with --data, of F.json, else "
        f"{SIZE[0]}x{SIZE[1]}); the vertical angle of view stays",
    )
    clip.add_argument(
        "--up",
        choices=UPS,
        metavar="AXIS",
        help="up without --data: x, y, z, -x, -y or -z (default: a guess)",
    )
    clip.add_argument(
        "--save-path", type=named_path, metavar="F.json", help="write the cameras to F.json, too"
    )


def run(args: argparse.Namespace) -> int:
    """Render; exit code 0."""
    from clgs.cli.display import Display
    from clgs.cli.tell import counted
    from clgs.errors import UsageError
    from clgs.workflow.pictures import OTHER_VIDEOS, render_clip, render_views

    views, options = view_options(vars(args)), chosen(vars(args), "kind", "overwrite")
    if args.path is not None:
        path = PathOptions(args.path, args.frames, args.fps, args.size, args.up)
        options["save_path"] = args.save_path
        with Display() as display:
            show(render_clip(args.scene, args.output, path, views, on_event=display, **options))
        return 0
    of_clips = chosen(vars(args), "frames", "fps", "size", "up", "save_path")
    refuse(of_clips, "belongs to a clip; give --path too")
    if args.output.suffix.lower() in (".mp4", *OTHER_VIDEOS):
        raise UsageError(f"{args.output}: a video is a clip; give --path, or name a folder")
    with Display() as display:
        count = render_views(args.scene, args.output, views, on_event=display, **options)
    print(f"{args.output}: {counted(count, 'picture')}")
    return 0


def show(clip: Clip) -> None:
    """Print what was written."""
    from clgs.cli.tell import counted

    print(
        f"{clip.path}: {counted(clip.frames, 'frame')} of {clip.width}x{clip.height}, "
        f"{clip.frames / clip.fps:.1f} s at {clip.fps:g} per second"
    )
