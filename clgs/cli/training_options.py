"""The options of training on the command line, made from their declarations."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from typing import Any

from clgs.cli.shared_options import named_path, value_of
from clgs.errors import UsageError
from clgs.train.config import TrainConfig, layered, parse_word, read_settings
from clgs.train.config.option import Option, Pair, Text, options_of
from clgs.train.config.run_settings import FULL_STEPS

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
