"""Options shared by the commands that look at a dataset's views."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgs.cli.run.source import run_folder
from clgs.cli.tell import tell
from clgs.data.reduction import MAX_SIZE, Reduction
from clgs.errors import DataError, UsageError
from clgs.options import PRESETS
from clgs.train.config import TrainConfig, from_toml
from clgs.train.config.option import Option, Range, options_of

if TYPE_CHECKING:
    from clgs.data.dataset import Dataset
    from clgs.data.view import View
    from clgs.options import RenderOptions
    from clgs.scene.scene import QuantizedScene, SplatScene


BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}


def add_view_options(parser: argparse.ArgumentParser, split: bool = True) -> None:
    """Add the options that choose views (--split if so), their rendering and the device."""
    add = parser.add_argument
    where = "that which the run folder of SCENE names"
    add("--data", type=Path, help=f"the data set that the scene was made of (default: {where})")
    if split:
        splits = ("train", "test")
        add("--split", choices=splits, help="which views (default: test)")
    add(
        "--background",
        choices=BACKGROUNDS,
        help="behind the scene (default: the scene's own; of a PLY file black)",
    )
    add_size_options(parser, "SCENE")
    trained = "as the config.toml beside SCENE says, else"
    add_accuracy_options(parser, f"{trained} parity", f"{trained} 0")
    add_memory_option(parser)
    add("--device", help="number or part of the name, see `clgs devices`")


def add_size_options(parser: argparse.ArgumentParser, scene: str) -> None:
    """Add --downscale and --max-size; ``scene``: how the command calls the scene."""
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--downscale",
        type=positive_int,
        metavar="N",
        help="reduce the photos N times",
    )
    size.add_argument(
        "--max-size",
        type=value_of(options_of(TrainConfig)["max_size"]),
        metavar="PIXELS",
        help="reduce photos that are wider to this width; 0: never (default of both: as the "
        f"config.toml beside {scene} says, else {MAX_SIZE})",
    )


def add_accuracy_options(
    parser: argparse.ArgumentParser, default: str, smallest_anchor: str
) -> None:
    """Add --accuracy and --smallest-anchor; the texts say what the default is."""
    declared = options_of(TrainConfig)
    parser.add_argument(
        "--accuracy",
        choices=tuple(PRESETS),
        help=f"{declared['accuracy'].help} (default: {default})",
    )
    parser.add_argument(
        "--smallest-anchor",
        type=value_of(declared["smallest_anchor"]),
        metavar="PIXELS",
        help=f"{declared['smallest_anchor'].help} (default: {smallest_anchor})",
    )


def add_memory_option(parser: argparse.ArgumentParser) -> None:
    """Add --max-memory."""
    parser.add_argument(
        "--max-memory",
        type=positive_int,
        metavar="MIB",
        help="draw in groups of tiles whose lists take at most this many MiB; slower, the same "
        "result (default: no limit)",
    )


def check_apart(output: Path, data: Path) -> None:
    """Refuse an output folder whose files would mix with the photos of a data set.

    Raises:
        UsageError: ``output`` is ``data``, or a folder in it that holds photos and no run.
    """
    from clgs.data.images import list_images
    from clgs.errors import UsageError

    if not (output.is_dir() and data.is_dir()):
        return
    own, folder = output.resolve(), data.resolve()
    inside = folder in own.parents and not (own / "config.toml").exists()
    if own == folder or (inside and list_images(own)):
        raise UsageError(f"{output}: is the folder of the photos; name another with -o")


def selected_views(args: argparse.Namespace, scene: QuantizedScene | SplatScene) -> list[View]:
    """The views that the options name, posed in the scene's units; their photos are not read yet.

    Raises:
        UsageError: no data set is named, neither by the options nor by the run.
        DataError: the split is empty, or the data set is that of another scene.
    """
    dataset = load_views(args, scene)
    split = split_of(args)
    views = dataset.test if split == "test" else dataset.train
    if not views:
        other = "train" if split == "test" else "test"
        raise DataError(f"{args.data}: has no {split} views; try --split {other}")
    return views


def split_of(args: argparse.Namespace) -> str:
    """Which views the options name."""
    return args.split or "test"


def load_views(args: argparse.Namespace, scene: QuantizedScene | SplatScene) -> Dataset:
    """The data set in the scene's units, without points; its photos are not read yet.

    Raises:
        UsageError: no data set is named, neither by the options nor by the run.
        DataError: nothing usable there, or the data set is that of another scene.
    """
    from clgs.data.dataset import load_dataset
    from clgs.data.origin import read_origin
    from clgs.data.repose import alike, repose
    from clgs.scene.scene import SplatScene

    if args.data is None:
        name_data(args)
    reduction = _reduction(args)
    dataset = load_dataset(
        args.data,
        downscale=reduction.times,
        max_size=reduction.max_size,
        load_images=False,
    )
    posed = repose(dataset, scene.transform)
    origin = read_origin(run_folder(args.scene))
    if isinstance(scene, SplatScene):
        return posed
    if origin is not None and origin.check(posed.train + posed.test, args.data):
        return posed
    if alike(dataset.transform, scene.transform, dataset.radius):
        if origin is not None:
            tell(
                f"clgs: {args.data} has none of the photos that the scene was trained with; if it "
                f"shows another scene, name {origin.folder} with --data"
            )
    else:
        if origin is not None:
            raise DataError(
                f"{args.data}: has none of the photos that the scene was trained with, and other "
                f"cameras; name {origin.folder} with --data"
            )
        tell(
            f"clgs: the cameras of {args.data} are placed unlike those that the scene was trained "
            "with; if it shows another scene, name the right one with --data"
        )
    return posed


def known_data(scene: Path) -> Path | None:
    """The data set that the run folder of ``scene`` names; None if there is none."""
    from clgs.data.origin import read_origin

    origin = read_origin(run_folder(scene))
    return origin.folder if origin is not None and origin.folder.is_dir() else None


def name_known_data(args: argparse.Namespace) -> None:
    """Set ``args.data``, unless it is given, if the run folder of ``args.scene`` names one."""
    args.data = args.data or known_data(args.scene)


def name_data(args: argparse.Namespace) -> None:
    """Set ``args.data`` to the data set that the run folder of ``args.scene`` names.

    Raises:
        UsageError: it names none, or that is gone.
    """
    from clgs.data.origin import read_origin

    origin = read_origin(run_folder(args.scene))
    if origin is None:
        raise UsageError("the photos are not known; name their data set with --data")
    check_photos_there(args.scene)
    args.data = origin.folder


def check_photos_there(scene: Path) -> None:
    """Raise UsageError if the run folder of ``scene`` names a data set that is gone."""
    from clgs.data.origin import read_origin

    origin = read_origin(run_folder(scene))
    if origin is not None and not origin.folder.exists():
        raise UsageError(f"the data set {origin.folder} is gone; name it with --data")


def over_background(
    args: argparse.Namespace, scene: QuantizedScene | SplatScene
) -> QuantizedScene | SplatScene:
    """The scene over the background that --background names, else as it is."""
    if args.background is None:
        return scene
    settings = replace(scene.settings, background=BACKGROUNDS[args.background])
    return replace(scene, settings=settings)


def selected_options(args: argparse.Namespace) -> RenderOptions:
    """From the options, else the run folder, else the defaults; with the memory budget."""
    from clgs.options import render_options

    trained = _trained_config(args.scene) or TrainConfig()
    smallest = args.smallest_anchor
    return render_options(
        args.accuracy or trained.accuracy,
        args.max_memory,
        trained.smallest_anchor if smallest is None else smallest,
    )


def _trained_config(scene: Path) -> TrainConfig | None:
    """The settings in the run folder that ``scene`` is or lies in."""
    path = run_folder(scene) / "config.toml"
    return from_toml(path.read_text(encoding="utf-8"), str(path)) if path.is_file() else None


def _reduction(args: argparse.Namespace) -> Reduction:
    """As asked for, else that of the run; the default, with a note, if that is not known."""
    if args.downscale is not None:
        return Reduction(args.downscale)
    if args.max_size is not None:
        return Reduction(0, args.max_size)
    config = _trained_config(args.scene)
    if config is not None:
        return Reduction(config.downscale, config.max_size)
    tell(f"clgs: no config.toml beside the scene; --max-size {MAX_SIZE} is assumed")
    return Reduction()


def trained_steps(scene: Path) -> int | None:
    """The --steps of the run that ``scene`` is of; None if that is not known."""
    config = _trained_config(scene)
    return config.steps if config is not None else None


def value_of(one: Option) -> Callable[[str], Any]:
    """The type of arguments that take the values of a declared option."""

    def parse(text: str) -> Any:
        try:
            return one.parse(text)
        except UsageError as error:  # argparse puts the name in front
            raise argparse.ArgumentTypeError(str(error).removeprefix(f"{one.name}: ")) from None

    return parse


def photo_width(text: str) -> int:
    """The type of arguments that photos are reduced to; unlike --max-size of training never 0."""
    declared = options_of(TrainConfig)["max_size"]
    assert isinstance(declared.allowed, Range)
    allowed = replace(declared.allowed, or_zero=False)
    return int(value_of(replace(declared, allowed=allowed))(text))


def whole_number(largest: int) -> Callable[[str], int]:
    """The type of arguments that must be whole numbers from 1 to ``largest``."""

    def parse(text: str) -> int:
        digits = text if text.isdecimal() else "0"
        value = int(digits) if len(digits) <= len(str(largest)) else largest + 1
        if not 1 <= value <= largest:
            named = text if len(text) <= 20 else f"{text[:17]}..."
            raise argparse.ArgumentTypeError(f"{named} is not a whole number from 1 to {largest}")
        return value

    return parse


positive_int = whole_number(2**31 - 1)


def named_path(text: str) -> Path:
    """An argument that must name a file or folder: an empty one would mean the current folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError("the name is empty")
    return Path(text)


def seed(text: str) -> int:
    """An argument that must be a whole number of at least 0."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of at least 0")
    return int(text)
