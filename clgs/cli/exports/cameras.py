"""``clgs export DATA -o cameras.glb``: cameras and points for 3-D viewers."""

from __future__ import annotations

import argparse

HELP = """\
from DATA: its points, if it has any, and the frustum of every camera,
         training cameras blue, held-out ones orange. Lengths are the world
         units of the data set; its up becomes glTF's y (Blender captures
         and transforms.json have z up, COLMAP models y down)."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """There are none."""


def run(args: argparse.Namespace) -> None:
    """Write the file and print one line."""
    from clgs.data.dataset import load_dataset
    from clgs.errors import UsageError
    from clgs.export.cameras import cameras_glb
    from clgs.files import atomic_write

    if args.source is None:
        raise UsageError("a data set is needed: `clgs export DATA -o cameras.glb`")
    dataset = load_dataset(args.source, load_images=False)
    data = cameras_glb(dataset)
    atomic_write(args.output, data)
    cameras = len(dataset.train) + len(dataset.test)
    print(f"{args.output}: {len(dataset.points):,} points, {cameras} cameras, {len(data):,} bytes")
