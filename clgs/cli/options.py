"""Options that several commands share, those of training among them, and types of their values."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from clgs.arguments import (
    MOST,
    OTHER_DIGITS,
    byte_count,
    has_other_digits,
    number,
    plain_float,
    seconds,
)
from clgs.data.reduction import MAX_SIZE, MEANINGS
from clgs.errors import UsageError
from clgs.options import BACKGROUNDS, PRESETS
from clgs.train.config import TrainConfig, layered, parse_word, read_settings
from clgs.train.config.option import Option, Pair, Range, Text, options_of
from clgs.train.config.run_settings import FULL_STEPS
from clgs.workflow.options import ViewOptions

MAX_SIDE = 16384
"""Pixels of a side of a rendered picture, at most."""


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


def add_test_every(parser: argparse.ArgumentParser) -> None:
    """Add --test-every of the commands that score held-out photos."""
    declared = options_of(TrainConfig)["test_every"]
    help_every = f"{declared.help} (default: as the config.toml next to SCENE says, else 8)"
    parser.add_argument("--test-every", type=value_of(declared), metavar="N", help=help_every)


def add_masks(parser: argparse._ActionsContainer, default: str) -> None:
    """Add --masks of the commands that compare with photos; ``default`` in words."""
    help_masks = f"{options_of(TrainConfig)['masks'].help} (default: {default})"
    parser.add_argument("--masks", choices=MEANINGS, default=argparse.SUPPRESS, help=help_masks)


def add_files(parser: argparse.ArgumentParser, name: str, source: str, output: str) -> None:
    """Add the argument ``name``, --output, shown as ``source`` and ``output``, and --overwrite.

    The command must pass both files to ``clgs.workflow.outputs.check_new``.
    """
    parser.add_argument(name, type=named_path, metavar=source)
    parser.add_argument("-o", "--output", type=named_path, required=True, metavar=output)
    add_overwrite(parser, "the output if it exists (default: refuse)")


def add_box(parser: argparse.ArgumentParser, what: str = "only the part in this box") -> None:
    """Add the option ``--box``: six numbers; ``what`` it does, in words."""
    form = "x0,y0,z0,x1,y1,z1"
    parser.add_argument("--box", type=numbers(form), metavar=form, help=what)


def add_level(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--level``, which the encoder checks."""
    parser.add_argument("--level", default="default", help="fast, default, max or paper")


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--threads``."""
    parser.add_argument(
        "--threads", type=positive_int, metavar="N", help="default: one per processor"
    )


def add_overwrite(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --overwrite; ``what`` it replaces, in words."""
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what}")


def add_cluster(
    parser: argparse.ArgumentParser,
    workers: str = "processes on this machine (default: 1)",
    default: int | None = 1,
) -> None:
    """Add --workers and --scheduler of the commands that train as tasks on dask.distributed.

    ``workers``: the help of --workers; ``default``: its value if it is not given.
    """
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=positive_int,
        default=default,
        metavar="N",
        help=workers,
    )
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a dask scheduler, such as tls://host:8786, whose workers see all folders under "
        "the same names; who reaches a scheduler can run code on its workers",
    )


def add_device_name(parser: argparse._ActionsContainer) -> None:
    """Add --device of the commands that use one device."""
    parser.add_argument("--device", help="number or part of the name, see `clgs devices`")


def view_options(values: Mapping[str, Any]) -> ViewOptions:
    """What the options of :func:`add_view_options` say; those that a command lacks are None."""
    return ViewOptions(**{one.name: values.get(one.name) for one in fields(ViewOptions)})


def chosen(values: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """The values of these names, which the function behind the command knows by the same names."""
    return {name: values[name] for name in names}


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


def plain_digits(text: str) -> str:
    """``text``; ArgumentTypeError if it has digits of another script."""
    if has_other_digits(text):
        raise argparse.ArgumentTypeError(f"{text} {OTHER_DIGITS}; write it with these")
    return text


def whole_number(largest: int, least: int = 1) -> Callable[[str], int]:
    """The type of arguments that must be whole numbers from ``least`` to ``largest``."""

    def parse(text: str) -> int:
        value = number(plain_digits(text))
        if not isinstance(value, int) or not least <= value <= largest:
            named = text if len(text) <= 20 else f"{text[:17]}..."
            limits = f"from {least} to {largest}" if largest < MOST else f"of at least {least}"
            raise argparse.ArgumentTypeError(f"{named} is not a whole number {limits}")
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


seed = whole_number(MOST, 0)


def size(text: str) -> int:
    """The type of an argument that is a number of bytes, as :func:`byte_count` reads it."""
    value = byte_count(plain_digits(text))
    if value is None:
        raise argparse.ArgumentTypeError(f"{text} is not a size such as 800k or 1.5MB")
    return value


def duration(text: str) -> float:
    """The type of an argument that is a time, as :func:`clgs.arguments.seconds` reads it."""
    value = seconds(plain_digits(text))
    if value is None or not 0 < value < 1e7:
        raise argparse.ArgumentTypeError(f"{text} is not a time such as 90s, 5m or 1h30m")
    return value


def frame_size(text: str) -> tuple[int, int]:
    """The type of an argument that is the width and the height of a picture in pixels."""
    found = re.fullmatch(r"(\d+) ?[x\u00d7] ?(\d+)", plain_digits(text).strip().lower())
    if found is None:
        raise argparse.ArgumentTypeError(f"{text} is not WIDTHxHEIGHT, such as 800x600")
    if not all(len(side) < 10 and 1 <= int(side) <= MAX_SIDE for side in found.groups()):
        raise argparse.ArgumentTypeError(f"{text}: sides are 1 to {MAX_SIDE} pixels")
    return int(found[1]), int(found[2])


def numbers(form: str) -> Callable[[str], list[float]]:
    """The type of arguments that are as many numbers, with commas between, as names in ``form``."""
    count = form.count(",") + 1

    def parse(text: str) -> list[float]:
        try:
            found = [plain_float(value) for value in plain_digits(text).split(",")]
        except ValueError:
            found = []
        if len(found) != count:
            needed = f"{count} numbers are needed, {form}"
            raise argparse.ArgumentTypeError(f"{text}: {needed}")
        return found

    return parse


def number_within(least: float, most: float, words: str) -> Callable[[str], float]:
    """The type of arguments that must be numbers from ``least`` to ``most``, which is ``words``."""

    def parse(text: str) -> float:
        try:
            value = plain_float(plain_digits(text))
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text} is not a number {words}")
        return value

    return parse


in_range = number_within(2.0**-64, 2.0**64, "from 2^-64 to 2^64 (5.5e-20 to 1.8e19)")
"""The type of a step, or of integers per unit: the range that a file can hold."""


LOSS_WEIGHTS = ("l1_weight", "ssim_weight")
"""The settings that --loss-weights sets."""


def add_training_options(parser: argparse.ArgumentParser) -> None:
    """Add --config, --set, and an option for every field of TrainConfig, under its heading."""
    parser.add_argument(
        "--config",
        type=named_path,
        metavar="FILE.toml",
        help="settings in place of the preset's, such as the config.toml of a run; options given "
        "here win over it",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any setting by the name that it has in the file, such as switch_step=5000 or "
        "learning_rates.offset=0.01,0.0001; may be given several times",
    )
    groups: dict[str, Any] = {}
    for one in options_of(TrainConfig).values():
        if one.group not in groups:
            groups[one.group] = parser.add_argument_group(one.group)
        add_option(groups[one.group], one)
    groups["loss"].add_argument(
        "--loss-weights",
        type=value_of(options_of(TrainConfig)["l1_weight"]),
        nargs=2,
        metavar=("L1", "SSIM"),
        help="l1-weight and ssim-weight in one",
    )


def add_option(group: argparse._ArgumentGroup, one: Option) -> None:
    """Add the command-line option of a declared one; it is absent from the result unless given."""
    choices = one.allowed if isinstance(one.allowed, tuple) else ()
    unit = "" if one.unit == "none" else one.unit
    limits = "" if choices or one.kind is bool else one.range
    remarks = filter(None, (unit, limits, f"default: {one.default_text or 'none'}"))
    shared: dict[str, Any] = {
        "dest": one.name,
        "default": argparse.SUPPRESS,
        "help": f"{one.help} ({'; '.join(remarks)})".replace("%", "%%"),
    }
    if one.kind is bool:
        group.add_argument(one.flag, action=argparse.BooleanOptionalAction, **shared)
    elif choices:
        group.add_argument(one.flag, choices=choices, **shared)
    else:
        metavar = {int: "N", Pair: "FIRST,LAST"}.get(one.kind, "X")
        if isinstance(one.allowed, Text):
            metavar = one.allowed.metavar
        group.add_argument(one.flag, type=value_of(one), metavar=metavar, **shared)


def make_config(words: Mapping[str, Any]) -> TrainConfig:
    """The configuration that the options describe, not yet resolved for a data set.

    A preset counts least, then the settings of the run to go on from, then --config, then all other
    options; of those, --set counts most.

    Args:
        words: the values of all options by their names in the parser.

    Raises:
        UsageError: a value has the wrong type or range, or values do not go together.
    """
    known = options_of(TrainConfig)
    given: dict[str, Any] = dict(zip(LOSS_WEIGHTS, words.get("loss_weights") or (), strict=False))
    given |= {name: value for name, value in words.items() if name in known}
    for word in words.get("set", ()):
        try:
            name, given[name] = parse_word(word)
        except UsageError as error:
            raise UsageError(f"--set {error}") from None
    start, file = words.get("start"), words.get("config")
    if start:
        from clgs.train.run.run_folder import check_finished

        check_finished(start)
    settings = [read_settings(path) for path in (start and start / "config.toml", file) if path]
    if start and "steps" not in given | (settings[1] if file else {}):
        given["steps"] = 2 * settings[0].get("steps", FULL_STEPS)
    if given.get("target_size") and given.get("size_lambda") is not None:
        raise UsageError("--lambda: follows from --target-size; give one of the two")
    if "max_size" in given:  # a reduction in the settings would win over it
        given.setdefault("downscale", 0)
    try:
        return layered(*settings, given)
    except UsageError as error:
        raise UsageError(with_flags(str(error))) from None


def with_flags(message: str) -> str:
    """``message`` with the settings that it names as the command line has them."""
    for one in options_of(TrainConfig).values():
        name, flag = re.escape(one.name), one.flag
        place = rf"\b{name}\b" if "_" in one.name else rf"^{name}(?=:)"
        message = re.sub(place, flag, message)
    return message
