"""Checks of callers' arguments, each with one clear line."""

from __future__ import annotations

import operator
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clgs.errors import CodecError, UsageError


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


def check_integers(name: str, values: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """``values`` (N, columns) as contiguous int32.

    Raises:
        TypeError: not an array of integers.
        CodecError: rows of several lengths, not two axes, a masked element, or out of range.
    """
    if np.ma.is_masked(values):
        hidden = np.count_nonzero(np.ma.getmask(values))
        raise CodecError(f"{name}: {hidden} elements are masked; fill them or leave out the rows")
    try:
        array = np.asarray(values)
    except ValueError:
        raise CodecError(f"{name}: rows of several lengths; (N, columns) is needed") from None
    if array.size == 0 and isinstance(values, list):
        raise CodecError(f"{name}: an empty list has no columns; np.empty((0, 3), int) has three")
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name}: dtype is {array.dtype}, integers are needed; round floats first")
    if array.ndim != 2:
        raise CodecError(f"{name}: shape is {array.shape}, two axes are needed")
    if array.size and not np.can_cast(array.dtype, np.int32):
        low, high = int(array.min()), int(array.max())
        if low < -(2**31) or high >= 2**31:
            raise CodecError(f"{name}: {low} to {high} is outside of int32; round to larger steps")
    return np.ascontiguousarray(array, np.int32)


def _shown(value: object) -> str:
    """On one line, shortened."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
