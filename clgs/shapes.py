"""Checks of arguments: array shapes by short specifications such as ``"N 3"``, types, choices."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from functools import cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from clgs.errors import UsageError


class Shaped(Protocol):
    """Anything with a shape and a dtype: a NumPy array or a device array."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Extent of every axis."""

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Element type."""


def check_type(name: str, value: object, kind: type, remedy: str) -> None:
    """Raise TypeError, one line with ``remedy``, unless ``value`` is of the class ``kind``."""
    if not isinstance(value, kind):
        raise TypeError(f"{name}: is {type(value).__name__}, {kind.__name__} is needed; {remedy}")


def check_integer(name: str, value: object) -> int:
    """``value`` as an int; TypeError if it is no integer, such as 2.0."""
    try:
        return operator.index(value)  # type: ignore[arg-type]  # what it is for
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


class Shapes:
    """Binds axis names to lengths over several checks, so that mismatches between arrays show.

    >>> shapes = Shapes()
    >>> shapes.check("mean", mean, "N 3", np.float32)
    >>> shapes.check("opacity", opacity, "N", np.float32)   # must have the same N
    """

    def __init__(self, **known: int) -> None:
        self.axes: dict[str, int] = dict(known)

    def check(self, name: str, array: Shaped, spec: str, dtype: npt.DTypeLike) -> None:
        """Compare ``array`` with ``spec``: names bind on first use, numbers are literal.

        Raises:
            ValueError: the shape does not fit.
            TypeError: the dtype differs.
        """
        wanted = _axes_of(spec)
        if len(array.shape) != len(wanted) or not self._fit(wanted, array.shape):
            bound = ", ".join(f"{a}={self.axes[a]}" for a in wanted if a in self.axes)
            hint = f" with {bound}" if bound else ""
            raise ValueError(
                f"{name}: shape is {array.shape}, expected ({', '.join(map(str, wanted))}){hint}"
            )
        if array.dtype != np.dtype(dtype):
            raise TypeError(f"{name}: dtype is {array.dtype}, expected {np.dtype(dtype)}")

    def _fit(self, wanted: tuple[str | int, ...], shape: tuple[int, ...]) -> bool:
        for axis, length in zip(wanted, shape, strict=True):
            expected = axis if isinstance(axis, int) else self.axes.setdefault(axis, length)
            if length != expected:
                return False
        return True


@cache
def _axes_of(spec: str) -> tuple[str | int, ...]:
    return tuple(int(axis) if axis.isdigit() else axis for axis in spec.split())
