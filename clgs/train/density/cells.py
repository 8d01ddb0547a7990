"""The grid of voxels that anchors lie on, and coarser cells of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError
from clgs.train.density.initial_anchors import GRID_BITS

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

Axes = npt.NDArray[np.float64]
"""Whole numbers (3, n): coordinates of voxels or cells, an axis after the other."""

TABLE_BITS = 18
FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""2^64 by the golden ratio: the upper bits of its products are spread evenly."""


@dataclass(frozen=True)
class Grid:
    """Window of 2^21 voxels per axis around the anchors; inside it keys are unique.

    low (3, 1): its first voxel.
    """

    low: Axes

    @classmethod
    def around(cls, voxels: Axes) -> Grid:
        """The window around anchors in the voxels (3, A).

        Raises:
            ClgsError: they are too far apart.
        """
        low, high = voxels.min(axis=1, keepdims=True), voxels.max(axis=1, keepdims=True)
        if not (high - low < 1 << GRID_BITS).all():
            raise ClgsError(
                f"anchors: extent is {int((high - low).max())} grid cells, must be below "
                f"2^{GRID_BITS}; use a larger voxel or a smaller Q_P"
            )
        return cls(np.floor((low + high) / 2) - ((1 << (GRID_BITS - 1)) - 1))

    def holds(self, coordinates: Axes) -> npt.NDArray[np.bool_]:
        """Which of the voxel coordinates (3, n) lie in the window; NaN does not."""
        inside = (coordinates >= self.low) & (coordinates < self.low + (1 << GRID_BITS))
        return np.asarray(inside.all(axis=0))

    def keys(self, cells: Axes, factor: int = 1) -> Integers:
        """(n,) keys of cells (3, n) of ``factor`` voxels, each the rounded voxel / ``factor``."""
        x, y, z = (cells - cells_of(self.low, factor)).astype(np.int64)
        return np.asarray((x << 2 * GRID_BITS) | (y << GRID_BITS) | z)


def voxels_of(position: Floats, q_position: float) -> Axes:
    """Grid coordinates (3, A) of positions (A, 3) float32(integer / q_position), exactly."""
    voxels = np.empty((3, len(position)))
    for axis in range(3):
        np.multiply(position[:, axis], q_position, out=voxels[axis], dtype=np.float64)
    return np.rint(voxels, out=voxels)


def position_integers(position: Floats, q_position: float) -> Integers:
    """Grid coordinates (A, 3) int64 of positions float32(integer / q_position), exactly."""
    return voxels_of(position, q_position).astype(np.int64).T


def cells_of(voxels: Axes, factor: int) -> Axes:
    """Cell coordinates of voxels: the nearest cell centre, halves to the even one."""
    return voxels if factor == 1 else np.rint(voxels / factor)


def occur(keys: Integers, among: Integers) -> npt.NDArray[np.bool_]:
    """Which of a few keys (n,), best ascending, occur among many.

    Sorting the many takes longest, so a table of the hashes of the few leaves out nearly all that
    are none of them.
    """
    table = np.zeros(1 << TABLE_BITS, np.bool_)
    table[_hashes(keys)] = True
    near = np.sort(np.compress(table[_hashes(among)], among))
    if not len(near):
        return np.zeros(len(keys), np.bool_)
    place = np.minimum(np.searchsorted(near, keys), len(near) - 1)
    return np.asarray(near[place] == keys)


def _hashes(keys: Integers) -> npt.NDArray[np.uint64]:
    return (keys.view(np.uint64) * FACTOR) >> np.uint64(64 - TABLE_BITS)
