"""`clgs render SCENE --data DATA -o DIR` or `--path PATH -o clip.mp4`: pictures of a scene."""

from __future__ import annotations

import argparse

from clgs.cli.counted import counted
from clgs.cli.options.output import add_overwrite, check_new
from clgs.cli.options.path import add_kind_options, add_path_options
from clgs.cli.options.view import add_view_options, named_path

DESCRIPTION = """\
Render the views of a data set as PNG files, or a clip along a path.

SCENE is a run folder, a .clgs file of `clgs train` or `clgs pack`, or an ordinary 3DGS PLY file,
whose coordinates are those of its data set."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    parser.add_argument(
        "scene", type=named_path, metavar="SCENE", help="run folder, .clgs or 3DGS .ply file"
    )
    add_view_options(parser)
    parser.add_argument(
        "-o", "--output", type=named_path, required=True, metavar="DIR|F.mp4", help="new pictures"
    )
    add_overwrite(parser, "the video, or pictures in DIR (default: refuse)")
    add_kind_options(parser)
    add_path_options(parser)


def run(args: argparse.Namespace) -> int:
    """Render; exit code 0."""
    from clgs.cli.options.path import check_path
    from clgs.cli.options.scene import check_there
    from clgs.cli.options.view import name_known_data

    if args.data is None:
        check_there(args.scene)
    if args.up is None:
        name_known_data(args)
    check_path(args)
    if args.path is not None:
        from clgs.cli.commands.render_path import render_path

        return render_path(args)
    return _render_views(args)


def _render_views(args: argparse.Namespace) -> int:
    from clgs.cli.commands.render_path import save_frame
    from clgs.cli.frames import Frames
    from clgs.cli.options.output import check_picture_folder
    from clgs.cli.options.scene import read_drawable
    from clgs.cli.options.view import (
        check_apart,
        over_background,
        selected_options,
        selected_views,
    )
    from clgs.cli.progress import track
    from clgs.export.image import picture_names
    from clgs.files import folder_to_fill
    from clgs.opencl.device import Device
    from clgs.render.renderer import Renderer
    from clgs.scene.scene import drawable

    check_picture_folder(args.output)
    check_apart(args.output, args.data)
    scene, _ = read_drawable(args.scene)
    views = selected_views(args, scene)
    names = picture_names([view.name for view in views])
    if args.output.exists():
        for name in names:
            check_new(args, args.output / name)
    shown = drawable(over_background(args, scene))
    renderer = Renderer(Device(args.device), shown, selected_options(args))
    renderer.check_budget((view.name, view.camera) for view in views)
    frames = Frames(renderer, args.kind, [view.camera for view in views])
    with folder_to_fill(args.output):
        for name, view in track(list(zip(names, views, strict=True)), "rendering"):
            save_frame(args.output / name, frames.draw(view.camera), scene.transform)
    print(f"{args.output}: {counted(len(views), 'picture')}")
    return 0
