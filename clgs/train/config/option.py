"""One training option: its help, range and unit, declared at its field and checked from there.

A field of a settings class is declared by :func:`option`. From that declaration follow the check
of its value, its command-line option, its row in the documentation and its place in a TOML file.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from typing import Any, get_type_hints

from clgs.arguments import OTHER_DIGITS, byte_count, has_other_digits, number
from clgs.errors import UsageError

METADATA = "option"
"""Key of a field's metadata under which its declaration lies."""

LARGEST_INTEGER = 2**63 - 1
"""The largest whole number of a TOML file."""

FLAGS = {"size_lambda": "lambda"}
"""Names on the command line that differ from those in a file: Python keeps the word lambda."""

SHOWN = 40
"""Characters of a refused value that its message shows."""

Pair = tuple[float, float]
"""The first and the last value of what changes during a run."""


@dataclass(frozen=True)
class Range:
    """Numbers from ``least`` to ``most``, both included unless ``open_below``; 0 if ``or_zero``."""

    least: float
    most: float = float("inf")
    open_below: bool = False
    or_zero: bool = False

    def holds(self, value: float) -> bool:
        """Whether ``value`` lies in the range."""
        if self.or_zero and value == 0:
            return True
        return self.least <= value <= self.most and not (self.open_below and value == self.least)

    def __str__(self) -> str:
        """The range in words, as "at least 1" or "0 or from 4 to 8"; empty if it has no bounds."""
        if self.or_zero:
            return f"0 or {replace(self, or_zero=False)}"
        if self.most < float("inf"):
            return f"from {self.least:g} to {self.most:g}"
        if self.least == -float("inf"):
            return ""
        return f"{'above' if self.open_below else 'at least'} {self.least:g}"


MAX_WEIGHT = 1e6
"""Adam squares the gradients: with weights much above it they overflow, and nothing trains."""

ANY = Range(-float("inf"))
POSITIVE = Range(0, open_below=True)
WEIGHT = Range(0, MAX_WEIGHT)


def at_least(least: float) -> Range:
    """Numbers from ``least`` on."""
    return Range(least)


@dataclass(frozen=True)
class Text:
    """Any text but an empty one; ``what`` says what it names, such as "a file".

    metavar: what stands for it in the help of the command line.
    """

    what: str
    metavar: str = "FILE"


Allowed = Range | Text | tuple[str, ...]
"""Numbers in a range, a text, or one of several words."""


@dataclass(frozen=True)
class Option:
    """A declared option: ``name`` as in a TOML file, dotted in a table; ``kind``: its type.

    The other fields are those that :func:`option` describes.
    """

    default: Any
    help: str
    allowed: Allowed
    unit: str
    group: str
    open_default: str
    scaled: bool
    in_digest: bool
    later: bool
    before: Any
    name: str = ""
    kind: Any = None

    @property
    def flag(self) -> str:
        """The option of ``clgs train``, with its hyphens."""
        return f"--{FLAGS.get(self.name, self.name).replace('_', '-')}"

    @property
    def default_text(self) -> str:
        """The default in words, or as one would type it; empty if it is no value."""
        return self.open_default or _text(self.default)

    @property
    def least(self) -> int:
        """The least whole number that it may be."""
        return math.ceil(self.allowed.least) if isinstance(self.allowed, Range) else 0

    @property
    def range(self) -> str:
        """What values it may have, in words; empty if every number is allowed."""
        if self.kind is bool:
            return "true or false"
        if isinstance(self.allowed, tuple):
            return " or ".join(filter(None, (", ".join(self.allowed[:-1]), self.allowed[-1])))
        return self.allowed.what if isinstance(self.allowed, Text) else str(self.allowed)

    @property
    def wanted(self) -> str:
        """What to give instead of a refused value."""
        if not isinstance(self.allowed, Range):
            return self.range
        noun = {int: "a whole number", Pair: "two numbers"}.get(self.kind, "a number")
        example = ", such as 800k or 1.5M" if self.unit == "bytes" else ""
        if self.kind == Pair:
            example = ", such as {:g},{:g}".format(*self.default)
        limits = str(self.allowed)
        if self.allowed.or_zero:
            return f"{noun}, {limits}{example}"
        limits = limits.replace("at least", "of at least")
        return " ".join(filter(None, (noun, limits))) + example

    def check(self, value: object) -> Any:
        """``value`` with whole numbers made floats if the option's type says so.

        Raises:
            UsageError: it has the wrong type or range; names the option and what to give.
        """
        problem, found = self._judge(value)
        if problem:
            shown = repr(value)
            shown = shown if len(shown) <= SHOWN else f"{shown[: SHOWN - 3]}..."
            raise UsageError(f"{self.name}: {shown} {problem}; give {self.wanted}")
        return found

    def _judge(self, value: object) -> tuple[str, Any]:
        """What is wrong with ``value``, or nothing, and the value to keep."""
        if value is None and self.kind == float | None:  # it is chosen later
            return "", None
        if isinstance(self.allowed, Range):
            return self._judge_numbers(value, self.allowed)
        if self.kind is bool:
            return ("" if isinstance(value, bool) else "is not true or false"), value
        if isinstance(self.allowed, Text):
            usable = isinstance(value, str) and (value == self.default or value.strip())
            return ("" if usable else "is no name"), value
        return ("" if value in self.allowed else "is not known"), value

    def _judge_numbers(self, value: object, allowed: Range) -> tuple[str, Any]:
        if self.kind == Pair:
            numbers = value if isinstance(value, tuple | list) else ()
            if len(numbers) != 2 or not all(map(_is_number, numbers)):
                return "is not two finite numbers", value
            found: Any = tuple(map(float, numbers))
            return ("" if all(map(allowed.holds, found)) else "is out of range"), found
        whole = self.kind is int
        if not _is_number(value) or (whole and not isinstance(value, int)):
            return f"is not a {'whole' if whole else 'finite'} number", value
        found = value if whole else float(value)  # type: ignore[arg-type]  # a number, see above
        usable = allowed.holds(found) and (not whole or abs(found) <= LARGEST_INTEGER)
        return ("" if usable else "is out of range"), found

    def parse(self, text: str) -> Any:
        """The value that ``text`` stands for on a command line.

        Raises:
            UsageError: as :meth:`check`.
        """
        value: object = text
        if self.kind is bool:
            value = {"true": True, "false": False}.get(text, text)
        elif isinstance(self.allowed, Range) and has_other_digits(text):
            raise UsageError(f"{self.name}: {text} {OTHER_DIGITS}; give {self.wanted}")
        elif self.kind == Pair:
            value = tuple(map(_number, text.strip("[]").split(",")))
        elif isinstance(self.allowed, Range):
            value = _number(text)
            if self.unit == "bytes" and not isinstance(value, int):
                value = byte_count(text) or value
        elif isinstance(self.allowed, Text) and not text.strip():
            # the default, an empty name, cannot be asked for by accident
            raise UsageError(f"{self.name}: {text!r} is no name; give {self.wanted}")
        return self.check(value)


def _is_number(value: object) -> bool:
    """Whether ``value`` is a number that a float can hold; false for true, false, inf and nan."""
    is_real = isinstance(value, int | float) and not isinstance(value, bool)
    return is_real and abs(value) <= sys.float_info.max  # type: ignore[arg-type]  # it is real


def _number(text: str) -> object:
    """``text`` as int or float if it is one, else as it is."""
    found = number(text)
    return text if found is None else found


def option(
    default: Any,
    help: str,
    allowed: Allowed = (),
    *,
    unit: str = "",
    group: str = "",
    open_default: str = "",
    scaled: bool = False,
    in_digest: bool = True,
    later: bool = False,
    before: Any = None,
) -> Any:
    """Declare a field of a settings class.

    Args:
        default: its value unless something else is asked for.
        help: one sentence for ``clgs train --help`` and the documentation.
        allowed: a range of numbers, a tuple of words, or a Text; nothing for true or false.
        unit: of a number, for example "steps"; "none" if it has none.
        group: heading of this option and of those after it, up to the next with a heading.
        open_default: what is chosen for the data set if ``default`` (None or 0) leaves it open.
        scaled: a moment of the run, which moves in proportion when ``steps`` changes.
        in_digest: whether a run may be resumed only with the same value; False if the result does
            not depend on it.
        later: runs were begun before there was this setting.
        before: the value with which these trained; None: as ``default`` does.
    """
    help += "; moves with steps" if scaled else ""
    before = default if before is None else before
    declared = Option(
        default, help, allowed, unit, group, open_default, scaled, in_digest, later, before
    )
    return field(default=default, metadata={METADATA: declared})


def step_number(default: int, help: str, group: str = "") -> Any:
    """Declare a step number, 0 for none, as an option that moves with ``steps``."""
    return option(default, help, at_least(0), unit="step number", group=group, scaled=True)


def rates(first: float, last: float, what: str, group: str = "") -> Any:
    """Declare the first and the last learning rate of ``what`` as an option."""
    help = f"first and last learning rate of {what}"
    return option((first, last), help, POSITIVE, unit="per step", group=group)


def older_values(settings: type) -> dict[str, Any]:
    """What runs trained with that were begun before a setting, if its default is another, by name.

    Raises:
        TypeError: as :func:`options_of`.
    """
    options = options_of(settings).items()
    return {name: one.before for name, one in options if one.before != one.default}


@cache
def options_of(settings: type) -> dict[str, Option]:
    """The options that a settings class declares, by name, in order; those of tables are dotted.

    Raises:
        TypeError: a field is neither declared by :func:`option` nor a settings class itself.
    """
    return {one.name: one for one in _declared(settings, "")}


def _declared(settings: type, prefix: str) -> Iterator[Option]:
    hints, group = get_type_hints(settings), ""
    for one in fields(settings):
        name, kind = f"{prefix}{one.name}", hints[one.name]
        if METADATA in one.metadata:
            declared: Option = one.metadata[METADATA]
            group = declared.group or group
            yield replace(declared, name=name, kind=kind, group=group)
        elif isinstance(kind, type) and is_dataclass(kind):
            yield from _declared(kind, f"{name}.")
        else:
            raise TypeError(f"{settings.__name__}.{one.name}: declare it by option(...)")


def _text(value: object) -> str:
    """A default as one would type it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
