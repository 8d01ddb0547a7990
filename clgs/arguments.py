"""Checks of what users of the library and of the commands give.

Types, paths, integers and choices; sizes, times and numbers as people write them: 800k, 40 KB,
1h30m, 1e3.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from clgs.errors import UsageError


def check_type(name: str, value: object, kind: type, remedy: str) -> None:
    """Raise TypeError, one line with ``remedy``, unless ``value`` is of the class ``kind``."""
    if not isinstance(value, kind):
        raise TypeError(f"{name}: is {type(value).__name__}, {kind.__name__} is needed; {remedy}")


def as_path(name: str, value: Any) -> Path:
    """``value`` as a path; TypeError if it names none, such as a list of them."""
    try:
        return Path(value)
    except TypeError:
        raise TypeError(f"{name}: {_shown(value)}; a path is needed, as text or Path") from None


def check_integer(name: str, value: Any) -> int:
    """``value`` as an int; TypeError if it is no integer, such as 2.0 or True."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: {_shown(value)}; an integer is needed") from None


def check_range(name: str, value: Any, least: int, most: int | None = None) -> None:
    """Raise UsageError unless ``value`` is within a range, TypeError unless it is an integer."""
    number = check_integer(name, value)
    if number < least or (most is not None and number > most):
        allowed = f"at least {least}" if most is None else f"{least} to {most}"
        raise UsageError(f"{name}: {value} is out of range; give {allowed}")


def check_choice(name: str, value: object, known: Sequence[str]) -> None:
    """Raise UsageError unless ``value`` is one of ``known``, TypeError unless it is a string."""
    if not isinstance(value, str):
        raise TypeError(f"{name}: {_shown(value)}; a string is needed")
    if value not in known:
        raise UsageError(f"{name}: {value!r}; known are {', '.join(known)}")


def _shown(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


Value = TypeVar("Value")

OTHER_DIGITS = "has digits other than 0 to 9"
"""Why a number that is written in another script is refused: another script has other rules."""

UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 2**10, "mi": 2**20, "gi": 2**30}

MOST = 2**63

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"

_TIME = (
    rf"(?:(?P<hours>{_NUMBER}) ?h(?:rs?|ours?)?)? ?"
    rf"(?:(?P<minutes>{_NUMBER}) ?m(?:in(?:ute)?s?)?)? ?"
    rf"(?:(?P<last>{_NUMBER}) ?(?P<unit>s(?:ec(?:ond)?s?)?)?)?"
)


def has_other_digits(text: str) -> bool:
    """Whether ``text`` has a digit of another script, which Python reads as a number."""
    return any(letter.isdecimal() and not letter.isascii() for letter in text)


def plain_numbers(value: Value) -> Value:
    """``value``: a number, a text, or lists of them; its texts are ASCII without underscores.

    Raises:
        ValueError: they are not, though Python and NumPy take them for numbers.
    """
    text = str(value)
    if not text.isascii() or "_" in text:
        raise ValueError(f"{text[:40]!r} is no number")
    return value


def plain_float(text: str) -> float:
    """The number in ``text``; ValueError if it is none."""
    return float(plain_numbers(text))


def number(text: str) -> int | float | None:
    """The number in ``text``; None if it is none. 1e3 is a whole number, 1000.0 is not."""
    text = text.strip().lower()
    try:
        value = plain_float(text)
    except ValueError:
        return None
    if re.fullmatch(r"[+-]?\d{1,30}", text):
        return int(text)
    return int(value) if re.fullmatch(r"[+-]?\d+e\+?\d{1,2}", text) else value


def byte_count(text: str) -> int | None:
    """A number of bytes such as 800k, 1.5M, 40KB or 2 MiB; None if ``text`` is no such size.

    k, M and G are 10^3, 10^6 and 10^9 of them, Ki, Mi and Gi 2^10, 2^20 and 2^30; B may follow.
    """
    found = re.fullmatch(rf"({_NUMBER}) ?([kmg]?i?)b?", text.strip().lower(), re.ASCII)
    if found is None or found[2] not in UNITS:
        return None
    value = float(found[1]) * UNITS[found[2]]
    return int(value) if 1 <= value < MOST else None


def seconds(text: str) -> float | None:
    """A time such as 90s, 5 min, 1.5h or 1h30m in seconds; None if ``text`` is none.

    A number without a unit is seconds, and minutes after hours (1h30).
    """
    found = re.fullmatch(_TIME, text.strip().lower(), re.ASCII)
    if found is None or not any(found.groups()):
        return None
    hours, minutes, last = (float(found[part] or 0) for part in ("hours", "minutes", "last"))
    minutes_last = found["hours"] and not (found["minutes"] or found["unit"])
    return 3600 * hours + 60 * minutes + (60 if minutes_last else 1) * last
