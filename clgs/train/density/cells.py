"""The grid of voxels that anchors lie on, and coarser cells of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError
from clgs.train.density.initial_anchors import GRID_BITS

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Grid:
    """Window of 2^21 voxels per axis around the anchors; inside it keys are unique."""

    low: Integers

    @classmethod
    def around(cls, integers: Integers) -> Grid:
        """The window around anchors in the voxels (A, 3).

        Raises:
            ClgsError: they are too far apart.
        """
        low, high = (np.array([each(axis) for axis in integers.T]) for each in (np.min, np.max))
        if not (high - low < 1 << GRID_BITS).all():
            raise ClgsError(
                f"anchors: extent is {int((high - low).max())} grid cells, must be below "
                f"2^{GRID_BITS}; use a larger voxel or a smaller Q_P"
            )
        return cls((low + high) // 2 - ((1 << (GRID_BITS - 1)) - 1))

    def holds(self, coordinates: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Which of the voxel coordinates (n, 3) lie in the window; NaN does not."""
        inside = (coordinates >= self.low) & (coordinates < self.low + (1 << GRID_BITS))
        return np.asarray(inside.all(axis=1))

    def keys(self, cells: Integers, factor: int = 1) -> Integers:
        """(n,) keys of cells (n, 3) of ``factor`` voxels, each the rounded voxel / ``factor``."""
        x, y, z = (cells - cells_of(self.low, factor)).T
        return np.asarray((x << 2 * GRID_BITS) | (y << GRID_BITS) | z)


def position_integers(position: Floats, q_position: float) -> Integers:
    """Grid coordinates (A, 3) int64 of positions float32(integer / q_position), exactly.

    Each axis lies in one piece, which is what reductions and keys are fastest on.
    """
    return np.rint(position.T.astype(np.float64, order="C") * q_position).astype(np.int64).T


def cells_of(integers: Integers, factor: int) -> Integers:
    """Cell coordinates of voxels: the nearest cell centre, halves to the even one."""
    return integers if factor == 1 else np.rint(integers / factor).astype(np.int64)
