"""Check array shapes against short specifications such as ``"N 3"``."""

from __future__ import annotations

from functools import cache
from typing import Protocol

import numpy as np
import numpy.typing as npt


class Shaped(Protocol):
    """Anything with a shape and a dtype: a NumPy array or a device array."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Extent of every axis."""

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Element type."""


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
        wanted, shape = _axes_of(spec), array.shape
        fits = len(shape) == len(wanted)
        for axis, length in zip(wanted, shape, strict=False):  # no generator: it is called often
            known = axis if isinstance(axis, int) else self.axes.setdefault(axis, length)
            fits = fits and length == known
        if not fits:
            bound = ", ".join(f"{a}={self.axes[a]}" for a in wanted if a in self.axes)
            hint = f" with {bound}" if bound else ""
            raise ValueError(
                f"{name}: shape is {array.shape}, expected ({', '.join(map(str, wanted))}){hint}"
            )
        if array.dtype != dtype:
            raise TypeError(f"{name}: dtype is {array.dtype}, expected {np.dtype(dtype)}")


@cache
def _axes_of(spec: str) -> tuple[str | int, ...]:
    return tuple(int(axis) if axis.isdigit() else axis for axis in spec.split())
