"""`clgs render SCENE --data DATA --split test -o DIR`: pictures of a scene."""

from __future__ import annotations

import argparse
from pathlib import Path

from clgs.cli.options.output import add_overwrite, check_new
from clgs.cli.options.view import add_view_options, named_path


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser("render", help="render the views of a dataset as PNG files")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="run folder or .clgs file")
    add_view_options(parser)
    parser.add_argument("-o", "--output", type=named_path, required=True, metavar="DIR")
    add_overwrite(parser, "pictures in DIR (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Render; exit code 0."""
    from clgs.cli.options.scene import read_scene
    from clgs.cli.options.view import check_apart, name_data, selected_options, selected_views
    from clgs.cli.progress import track
    from clgs.export.image import picture_names, save_png
    from clgs.files import check_folder
    from clgs.opencl.device import Device
    from clgs.render.renderer import Renderer
    from clgs.train.quality.metrics import to_8bit

    check_folder(args.output)
    if args.data is None:
        name_data(args)
    check_apart(args.output, args.data)
    scene, _ = read_scene(args.scene)
    views = selected_views(args, scene)
    names = picture_names([view.name for view in views])
    if args.output.exists():
        for name in names:
            check_new(args, args.output / name)
    renderer = Renderer(Device(args.device), scene.dequantize(), selected_options(args))
    renderer.check_budget((view.name, view.camera) for view in views)
    args.output.mkdir(parents=True, exist_ok=True)
    for name, view in track(list(zip(names, views, strict=True)), "rendering"):
        save_png(args.output / name, to_8bit(renderer.render(view.camera)))
    print(f"{args.output}: {len(views)} pictures")
    return 0
