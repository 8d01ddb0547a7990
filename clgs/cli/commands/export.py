"""``clgs export``: what clgs knows, in a file that other programs open."""

from __future__ import annotations

import argparse
from pathlib import Path

from clgs.cli.options.output import add_overwrite, check_new, check_suffix
from clgs.cli.options.view import named_path


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "export",
        help="write the cameras and points of a data set as a GLB file",
        description="Write the points of a data set, if it has any, and the frustum of every "
        "camera to a GLB file, which 3-D viewers open: training cameras blue, held-out ones "
        "orange. Lengths are the world units of the data set. Its up becomes glTF's y: Blender "
        "captures and transforms.json have z up, COLMAP models y down. `clgs train --points` turns "
        "a GLB file back.",
    )
    parser.add_argument("data", type=Path, metavar="DATA", help="a data set, as for `clgs train`")
    parser.add_argument(
        "-o", "--output", type=named_path, required=True, metavar="cameras.glb", help="new file"
    )
    add_overwrite(parser, "the file if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Write the file and print one line; exit code 0."""
    from clgs.data.dataset import load_dataset
    from clgs.export.cameras import cameras_glb
    from clgs.files import atomic_write

    check_suffix(args.output, ".glb")
    check_new(args, args.output)
    dataset = load_dataset(args.data, load_images=False)
    data = cameras_glb(dataset)
    atomic_write(args.output, data)
    cameras = len(dataset.train) + len(dataset.test)
    print(f"{args.output}: {len(dataset.points):,} points, {cameras} cameras, {len(data):,} bytes")
    return 0
