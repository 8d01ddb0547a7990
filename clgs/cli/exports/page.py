"""``clgs export SCENE -o scene.html``: a scene as one web page, which needs nothing else."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clgs.export.page import Start

HELP = """\
from SCENE: one web page that decodes and draws the scene, offline;
         with --viewer and no SCENE: a page to drop .clgs files on."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --viewer; with --data the page starts at the first held-out view, upright."""
    parser.add_argument(
        "--viewer", action="store_true", help=".html: a page without a scene, to drop files on"
    )


def run(args: argparse.Namespace) -> None:
    """Write the page and print one line."""
    from clgs.errors import UsageError
    from clgs.export.page import scene_page
    from clgs.files import atomic_write, check_output

    if args.viewer and args.source is not None:
        raise UsageError("--viewer makes a page without a scene; leave it out, or the SCENE")
    if not args.viewer and args.source is None:
        raise UsageError("name a SCENE, or give --viewer for a page without one")
    data = b""
    if args.source is not None:
        data = read_file(args.source)
        check_output(args.output, args.source)
    start = read_start(args.data, data) if args.data is not None and data else None
    page = scene_page(data, args.source.stem if data else "", start)
    atomic_write(args.output, page)
    around = f", {len(data):,} of them the scene" if data else ""
    print(f"{args.output}: {len(page):,} bytes{around}")


def read_file(path: Path) -> bytes:
    """The bytes of a .clgs file, or of that in a run folder, once its container is checked.

    Raises:
        DataError: there is none, or it is damaged.
    """
    from clgs.cli.options.scene import instead, naming, read_bytes
    from clgs.cli.run.source import run_folder
    from clgs.codec import scene_decoder, splat_packing
    from clgs.errors import DataError

    if path.is_dir():
        file = run_folder(path) / "scene.clgs"
        if not file.exists():
            raise DataError(f"{path}: is a folder without scene.clgs; {instead(path)}")
        path = file
    elif path.suffix.lower() == ".ply":
        raise DataError(f"{path}: a page is made of a .clgs file; `clgs pack` makes one of splats")
    data = read_bytes(path)
    with naming(path):
        (splat_packing if splat_packing.is_splats(data) else scene_decoder).describe(data)
    return data


def read_start(path: Path, data: bytes) -> Start:
    """Where the page starts: the first held-out view of the data set at ``path``.

    Raises:
        DataError: there is no data set.
    """
    from clgs.codec.scene_decoder import describe
    from clgs.codec.splat_packing import is_splats
    from clgs.data.dataset import load_dataset
    from clgs.data.repose import repose
    from clgs.export.page import start_at
    from clgs.scene.scene import SceneTransform

    transform = SceneTransform()  # splats keep the data set's units
    if not is_splats(data):
        transform = SceneTransform(**describe(data)["transform"])
    dataset = load_dataset(path, load_images=False, load_points=False)
    views = repose(dataset, transform)
    first = (views.test or views.train)[0]
    return start_at(first.camera, [view.camera for view in views.train])
