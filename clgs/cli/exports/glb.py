"""``clgs export SCENE|DATA -o x.glb``: Gaussians of a scene, or cameras of a data set."""

from __future__ import annotations

import argparse
from pathlib import Path

from clgs.cli.exports import baked, cameras

HELP = f"""\
from SCENE: the same as glTF's KHR_gaussian_splatting, y up;
         {cameras.HELP}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Those of baking serve."""


def run(args: argparse.Namespace) -> None:
    """Write the file and say what it is."""
    scene = args.source is not None and is_scene(args.source)
    (baked if scene else cameras).run(args)


def is_scene(path: Path) -> bool:
    """Whether a file or a run folder is named, no data set."""
    from clgs.cli.run.source import run_folder

    return path.is_file() or (run_folder(path) / "scene.npz").exists()
