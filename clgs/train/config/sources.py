"""Settings from presets, TOML files and NAME=VALUE words, checked one by one, in layers."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from clgs.errors import DataError, UsageError
from clgs.train.config.option import Option, older_values, options_of
from clgs.train.config.run_settings import LearningRates
from clgs.train.config.settings import PAPER_Q, TrainConfig
from clgs.train.config.size_settings import GROWTH_THRESHOLD

MAX_BYTES = 1 << 20
"""A larger file holds no settings."""

ALWAYS = ("steps", "accuracy", "downscale", "max_size", "learning_rates.offset")
"""Without these a run's file is cut short, or its photos would have another size."""


PAPER_RATES = LearningRates(feature=(0.0075, 0.0075), scaling=(0.007, 0.007))

Values = Mapping[str, Any]
"""Checked values by name; those of tables are dotted."""

Settings = TypeVar("Settings", TrainConfig, LearningRates)


def preset(name: str) -> TrainConfig:
    """A named configuration.

    "default": 30,000 steps. "quick": the same at 3,000 steps, see :meth:`TrainConfig.scaled`.
    "paper": the data's own units, Q_P as published and the pooled rate proxy, so that published
    numbers can be compared; its loss weights are the code's 0.8 / 0.2, which made those numbers
    (the paper's text says 0.2 / 0.8).

    Raises:
        UsageError: no such preset.
    """
    config = TrainConfig(preset=name)
    if name == "quick":
        return config.scaled(3_000)
    if name == "paper":
        return replace(
            config,
            normalize=False,
            proxy="pooled",
            size_lambda=0.0,
            rate_weight=1e-4,
            growth_threshold=GROWTH_THRESHOLD,
            freeze_step=config.steps,
            average=False,
            **PAPER_Q,
            mlp="float32",
            learning_rates=PAPER_RATES,
            start_points=100_000,
            start_volume="cube",
            start_pixels=0.0,
            start_fill=1.0,
            start_mlps="random",
        )
    return config


def layered(*layers: Values) -> TrainConfig:
    """The preset that the last layer with one names, with each layer over those before it.

    ``steps`` in a layer scales what lies below, as :meth:`TrainConfig.scaled`; the other values of
    that layer are taken as they are.

    Raises:
        UsageError: values that do not go together.
    """
    names = [layer["preset"] for layer in layers if "preset" in layer]
    config = preset(names[-1] if names else "default")
    waiting: dict[str, Any] = {}
    for layer in layers:
        if "steps" in layer:
            config = _with(config, waiting).scaled(layer["steps"])
            waiting = {}
        waiting |= {name: layer[name] for name in layer if name not in ("preset", "steps")}
    return _with(config, waiting)


def _with(config: TrainConfig, values: Values) -> TrainConfig:
    """``config`` with ``values``, of which dotted ones belong to a table."""
    plain = {name: value for name, value in values.items() if "." not in name}
    for table in {name.split(".")[0] for name in values} - set(plain):
        inner = {name.split(".")[1]: values[name] for name in values if f"{table}." in name}
        plain[table] = _replaced(getattr(config, table), inner)
    return _replaced(config, plain)


def _replaced(settings: Settings, values: Values) -> Settings:
    """``settings`` with ``values``; UsageError if they have no such name."""
    if unknown := values.keys() - {one.name for one in fields(settings)}:
        raise UsageError(f"{type(settings).__name__} has no setting {sorted(unknown)[0]!r}")
    return replace(settings, **values)


def from_toml(text: str, name: str = "config.toml") -> TrainConfig:
    """The configuration that :meth:`TrainConfig.to_toml` wrote, perhaps of an older version.

    Missing settings are those of the file's preset, scaled to the file's steps, or as they were
    before there was such a setting; some must be there.

    Raises:
        DataError: not TOML, cut short, an unknown name or a value of the wrong type or range.
    """
    try:
        values = parse_settings(text, name)
    except UsageError as error:
        raise DataError(str(error)) from error
    try:
        config = layered({**older_values(TrainConfig), **values})
    except UsageError as error:
        raise DataError(f"{name}: {error}") from error
    if missing := [each for each in ALWAYS if each not in values]:
        raise DataError(f"{name}: has no {', '.join(missing)}, as if cut short; restore it")
    return config


def read_settings(path: Path) -> dict[str, Any]:
    """The settings in a TOML file by name, checked; those of tables are dotted.

    Raises:
        UsageError: no such file, not TOML, an unknown name or a value of the wrong type or range.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise UsageError(f"{path}: has more than {MAX_BYTES} bytes; name a file of settings")
        return parse_settings(content.decode("utf-8-sig"), str(path))
    except UnicodeDecodeError:
        raise UsageError(f"{path}: is not UTF-8 text; name a TOML file of settings") from None
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; name a TOML file of settings") from None


def parse_settings(text: str, source: str) -> dict[str, Any]:
    """Do what :func:`read_settings` does, with the text of the file ``source``.

    Raises:
        UsageError: as there.
    """
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UsageError(f"{source}: not a TOML file: {error}; correct or restore it") from error
    try:
        return {name: find(name).check(value) for name, value in _flat(table)}
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error


def parse_word(word: str) -> tuple[str, Any]:
    """Name and value of a word NAME=VALUE, such as ``learning_rates.offset=0.01,0.0001``.

    Raises:
        UsageError: no such form, an unknown name or a value of the wrong type or range.
    """
    name, equals, text = word.partition("=")
    if not equals or not name.strip():
        raise UsageError(f"{word!r} is not NAME=VALUE, such as switch_step=5000")
    name = name.strip().replace("-", "_")
    return name, find(name).parse(text.strip())


def find(name: str) -> Option:
    """The option of that name.

    Raises:
        UsageError: there is none; names the nearest.
    """
    known = options_of(TrainConfig)
    if name in known:
        return known[name]
    near = [one for one in known if one.startswith(f"{name}.")]
    near += get_close_matches(name, known, n=1) or [n for n in known if n.endswith(f".{name}")]
    remedy = f"did you mean {near[0]}?" if near else "`clgs train --help` lists all"
    raise UsageError(f"{name[:60]}: no such setting; {remedy}")


def _flat(table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and values; those of a table are dotted."""
    tables = {name.split(".")[0] for name in options_of(TrainConfig) if "." in name}
    for name, value in table.items():
        if name not in tables:
            yield name, value
        elif isinstance(value, dict):
            yield from ((f"{name}.{inner}", one) for inner, one in value.items())
        else:
            raise UsageError(f"{name}: is not a table; write [{name}] and a line per value")
