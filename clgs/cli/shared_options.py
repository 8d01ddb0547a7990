"""Options that several commands share, and types of their values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from clgs.data.masks import MEANINGS
from clgs.data.reduction import MAX_SIZE
from clgs.errors import UsageError
from clgs.options import PRESETS
from clgs.train.config import TrainConfig
from clgs.train.config.option import Option, Range, options_of
from clgs.workflow.options import BACKGROUNDS, ViewOptions


def add_view_options(parser: argparse.ArgumentParser, split: bool = True) -> None:
    """Add SCENE and the options that choose views (--split if so), their rendering, the device."""
    add = parser.add_argument
    add("scene", type=named_path, metavar="SCENE", help="run folder, .clgs or 3DGS .ply file")
    where = "the one that the run folder of SCENE names"
    add("--data", type=Path, help=f"the data set that the scene was made of (default: {where})")
    if split:
        add("--split", choices=("train", "test"), help="which views (default: test)")
    add(
        "--background",
        choices=BACKGROUNDS,
        help="behind the scene (default: the scene's own; of a PLY file black)",
    )
    add_size_options(parser, "SCENE")
    declared, trained = options_of(TrainConfig), "as the config.toml next to SCENE says, else"
    add(
        "--accuracy",
        choices=tuple(PRESETS),
        help=f"{declared['accuracy'].help} (default: {trained} parity)",
    )
    add(
        "--smallest-anchor",
        type=value_of(declared["smallest_anchor"]),
        metavar="PIXELS",
        help=f"{declared['smallest_anchor'].help} (default: {trained} 0)",
    )
    add(
        "--max-memory",
        type=positive_int,
        metavar="MIB",
        help="draw in groups of tiles whose lists take at most this many MiB; slower, the same "
        "result (default: no limit)",
    )
    add_device_name(parser)


def add_size_options(parser: argparse.ArgumentParser, scene: str) -> None:
    """Add --downscale and --max-size; ``scene``: how the command calls the scene."""
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--downscale", type=positive_int, metavar="N", help="reduce the photos N times"
    )
    size.add_argument(
        "--max-size",
        type=value_of(options_of(TrainConfig)["max_size"]),
        metavar="PIXELS",
        help="reduce photos that are wider to this width; 0: never (default of both: as the "
        f"config.toml next to {scene} says, else {MAX_SIZE})",
    )


def add_masks(parser: argparse.ArgumentParser, default: str) -> None:
    """Add --masks of the commands that compare with photos; ``default`` in words."""
    help_masks = f"{options_of(TrainConfig)['masks'].help} (default: {default})"
    parser.add_argument("--masks", choices=MEANINGS, help=help_masks)


def add_files(parser: argparse.ArgumentParser, name: str, source: str, output: str) -> None:
    """Add the argument ``name``, --output, shown as ``source`` and ``output``, and --overwrite.

    The command must pass both files to ``clgs.workflow.outputs.check_new``.
    """
    parser.add_argument(name, type=named_path, metavar=source)
    parser.add_argument("-o", "--output", type=named_path, required=True, metavar=output)
    add_overwrite(parser, "the output if it exists (default: refuse)")


def add_level(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--level``, which the encoder checks."""
    parser.add_argument("--level", default="default", help="fast, default, max or paper")


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--threads``."""
    parser.add_argument("--threads", type=int, metavar="N", help="default: one per processor")


def add_overwrite(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --overwrite; ``what`` it replaces, in words."""
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what}")


def add_device_name(parser: argparse.ArgumentParser) -> None:
    """Add --device of the commands that use one device."""
    parser.add_argument("--device", help="number or part of the name, see `clgs devices`")


def view_options(args: argparse.Namespace) -> ViewOptions:
    """What the options of :func:`add_view_options` say; those that a command lacks are None."""
    given = vars(args)
    return ViewOptions(**{one.name: given.get(one.name) for one in fields(ViewOptions)})


def chosen(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    """The options of these names, which the function behind the command knows by the same names."""
    return {name: getattr(args, name) for name in names}


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


AS_TRAINED = "as the config.toml next to the scene says, else ignore"
"""The default of --masks of commands that are given a scene."""

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


def number_within(least: float, most: float, words: str) -> Callable[[str], float]:
    """The type of arguments that must be numbers from ``least`` to ``most``, which is ``words``."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text} is not a number {words}")
        return value

    return parse


in_range = number_within(2.0**-64, 2.0**64, "from 2^-64 to 2^64 (5.5e-20 to 1.8e19)")
"""The type of a step, or of integers per unit: the range that a file can hold."""
