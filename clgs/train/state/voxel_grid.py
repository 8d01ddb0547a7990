"""The grid of voxels that anchors lie on, coarser cells of it, and the first anchors on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.errors import ClgsError, DataError
from clgs.scene.anchors import AnchorSet

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

Axes = npt.NDArray[np.float64]
"""Whole numbers (3, n): coordinates of voxels or cells, one axis after the other."""

GRID_BITS = 21
"""Positions span less than 2^21 voxels on each axis, so that three fit a 63-bit key."""

TABLE_BITS = 18
FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""2^64 by the golden ratio: the upper bits of its products are spread evenly."""

NEIGHBOURS = 3
"""Nearest neighbours whose mean squared distance sets an anchor's first scale."""

SQUARED_DISTANCE_FLOOR = 1e-7
"""Square scene units (Scaffold-GS)."""


@dataclass(frozen=True)
class VoxelWindow:
    """A window of 2^21 voxels per axis around the anchors, within which keys are unique.

    low (3, 1): its first voxel.
    """

    low: Axes

    @classmethod
    def around(cls, voxels: Axes) -> VoxelWindow:
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
    """Which of a few keys (n,), best in ascending order, occur among many; (n,) bool.

    Sorting the many takes longest. A table of the hashes of the few leaves out nearly all others
    before that.
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


def initial_anchors(
    points: npt.NDArray[np.floating], voxel: float, most: int = 0, seed: int = 0
) -> AnchorSet:
    """Make anchors at the voxels that hold points (VoxelGS, Scaffold-GS); rows ascend by (x, y, z).

    Position = float32(integer / Q_P) with Q_P = 1 / voxel, as ``dequantize`` computes it; offsets
    and features zero; all six scalings the log of the root of the mean squared distance to the 3
    nearest other anchors.

    Args:
        points: (P, 3), scene units.
        voxel: edge of a voxel, scene units.
        most: if there are more voxels, this many of them are drawn; 0: all stay.
        seed: of that draw.

    Raises:
        DataError: points not finite, too far apart for the grid, or in fewer than 4 voxels.
    """
    integers = voxel_integers(points, voxel)
    if 0 < most < len(integers):
        drawn = np.random.default_rng(seed).choice(len(integers), most, replace=False)
        integers = integers[np.sort(drawn)]
    position = (integers / np.float64(1.0 / voxel)).astype(np.float32)
    from scipy.spatial import cKDTree  # no block of a run in blocks needs it

    count, exact = len(position), position.astype(np.float64)
    distance, _ = cKDTree(exact).query(exact, k=NEIGHBOURS + 1)
    squared = np.maximum(np.square(distance[:, 1:]).mean(axis=1), SQUARED_DISTANCE_FLOOR)
    spacing = np.asarray(0.5 * np.log(squared), np.float32)
    return AnchorSet(
        position=position,
        offset=np.zeros((count, K_OFFSETS, 3), np.float32),
        feature=np.zeros((count, FEATURE_DIM), np.float32),
        scaling=np.repeat(spacing[:, None], 6, axis=1),
    )


def voxel_integers(points: npt.NDArray[np.floating], voxel: float) -> npt.NDArray[np.int64]:
    """Distinct voxels (A, 3) int64 that hold points (P, 3), ascending by (x, y, z).

    Raises:
        DataError: as :func:`initial_anchors`.
    """
    if not np.isfinite(points).all():
        raise DataError("start points: a coordinate is not finite; clean the data set's points")
    scaled = np.rint(np.asarray(points, np.float64) * (1.0 / voxel))
    limit = 2.0**GRID_BITS  # what 21 bits per axis, and float32 around the origin, hold exactly
    extent = float(np.ptp(scaled, axis=0).max()) if len(scaled) else 0.0
    if not extent < limit:
        raise DataError(
            f"start points: extent is {extent:.0f} voxels of {voxel}, must be below 2^{GRID_BITS}; "
            "use a larger voxel or remove far points"
        )
    if not np.abs(scaled).max(initial=0.0) <= limit:
        raise DataError(
            f"start points: more than 2^{GRID_BITS} voxels of {voxel} from the origin; "
            "recentre the data or use a larger voxel"
        )
    integers = np.unique(scaled.astype(np.int64), axis=0)
    if len(integers) <= NEIGHBOURS:
        raise DataError(
            f"start points: {len(points)} points in {len(integers)} voxels of {voxel}, at least "
            f"{NEIGHBOURS + 1} needed; give more points or a smaller voxel"
        )
    return integers
