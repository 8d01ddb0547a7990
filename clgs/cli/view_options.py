"""Options shared by the commands that look at a dataset's views."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clgs.data.dataset import Dataset, View
    from clgs.scene.scene import QuantizedScene


def add_view_options(parser: argparse.ArgumentParser, data_required: bool) -> None:
    """Add --data, --split, --downscale and --device."""
    add = parser.add_argument
    add("--data", type=Path, required=data_required, help="the dataset that the scene was made of")
    add("--split", choices=("train", "test"), default="test", help="which views (default: test)")
    add(
        "--downscale",
        type=positive_int,
        metavar="N",
        help="reduce the photos N times (default: as the config.toml beside SCENE says, else 1)",
    )
    add("--device", help="number or part of the name, see `clgs devices`")


def selected_views(args: argparse.Namespace, scene: QuantizedScene) -> list[View]:
    """The views that the options name, posed in the scene's units.

    Raises:
        DataError: the split is empty, or the dataset does not fit the scene.
    """
    from clgs.errors import DataError

    dataset = _load(args, scene)
    views = dataset.test if args.split == "test" else dataset.train
    if not views:
        raise DataError(f"{args.data}: has no {args.split} views; try --split train")
    return views


def _load(args: argparse.Namespace, scene: QuantizedScene) -> Dataset:
    from clgs.data.dataset import load_dataset
    from clgs.data.repose import repose

    downscale = args.downscale or trained_downscale(args.scene)
    return repose(load_dataset(args.data, downscale=downscale, load_points=False), scene.transform)


def trained_downscale(scene: Path) -> int:
    """The --downscale of the run folder that ``scene`` is or lies in; 1, said aloud, elsewhere."""
    from clgs.train.config import from_toml

    path = (scene if scene.is_dir() else scene.parent) / "config.toml"
    if path.is_file():
        return from_toml(path.read_text(encoding="utf-8"), str(path)).downscale
    print("clgs: no config.toml beside the scene; --downscale 1 is assumed", file=sys.stderr)
    return 1


def positive_int(text: str) -> int:
    """An argument that must be a whole number of at least 1."""
    value = int(text) if text.isdecimal() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of at least 1")
    return value
