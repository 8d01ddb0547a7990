"""Checks of arguments that users of the library give: types, paths, integers, choices."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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


def check_choice(name: str, value: object, known: Sequence[str]) -> None:
    """Raise UsageError unless ``value`` is one of ``known``, TypeError unless it is a string."""
    if not isinstance(value, str):
        raise TypeError(f"{name}: {_shown(value)}; a string is needed")
    if value not in known:
        raise UsageError(f"{name}: {value!r}; known are {', '.join(known)}")


def _shown(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
