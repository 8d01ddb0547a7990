"""The options of training as a table, for the command line and the documentation."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.train.config.option import Option, options_of
from clgs.train.config.settings import TrainConfig

FLAGS = {"size_lambda": "lambda"}
"""Names on the command line that differ from those in a file: Python keeps the word lambda."""


@dataclass(frozen=True)
class Row:
    """One option in words.

    name: in a TOML file and for ``--set``, dotted in a table; flag: of ``clgs train``; group: its
    heading; default, unit ("none" for a number without), range, help: texts for people, empty if
    there is nothing to say.
    """

    name: str
    flag: str
    group: str
    default: str
    unit: str
    range: str
    help: str


def describe_options() -> list[Row]:
    """Every option of training, in the order of the help."""
    return [describe(one) for one in options_of(TrainConfig).values()]


def describe(one: Option) -> Row:
    """The row of an option."""
    remark = "; moves with steps" if one.scaled else ""
    return Row(
        name=one.name,
        flag=f"--{FLAGS.get(one.name, one.name).replace('_', '-')}",
        group=one.group,
        default=one.open_default or _text(one.default),
        unit=one.unit,
        range=one.range,
        help=one.help + remark,
    )


def _text(value: object) -> str:
    """A default as one would type it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
