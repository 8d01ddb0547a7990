"""The anchors that training starts from: sparse points on the voxel grid (VoxelGS, Scaffold-GS)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.errors import DataError
from clgs.scene.anchors import AnchorSet

NEIGHBOURS = 3
"""Nearest neighbours whose mean squared distance sets an anchor's first scale."""

SQUARED_DISTANCE_FLOOR = 1e-7
"""Square scene units (Scaffold-GS)."""

GRID_BITS = 21
"""Positions span less than 2^21 voxels on each axis, so that three fit a 63-bit key."""


def initial_anchors(
    points: npt.NDArray[np.floating], voxel: float, most: int = 0, seed: int = 0
) -> AnchorSet:
    """Anchors at the voxels that hold points, rows ascending by (x, y, z).

    Position = float32(integer / Q_P) with Q_P = 1 / voxel, as ``dequantize`` computes it; offsets
    and features zero; all six scalings the log of the root of the mean squared distance to the 3
    nearest other anchors.

    Args:
        points: (P, 3), scene units.
        voxel: edge of a voxel, scene units.
        most: if there are more voxels than this, so many of them are drawn; 0: all.
        seed: of that draw.

    Raises:
        DataError: points not finite, too far apart for the grid, or in fewer than 4 voxels.
    """
    integers = voxel_integers(points, voxel)
    if 0 < most < len(integers):
        drawn = np.random.default_rng(seed).choice(len(integers), most, replace=False)
        integers = integers[np.sort(drawn)]
    position = (integers / np.float64(1.0 / voxel)).astype(np.float32)
    count = len(position)
    return AnchorSet(
        position=position,
        offset=np.zeros((count, K_OFFSETS, 3), np.float32),
        feature=np.zeros((count, FEATURE_DIM), np.float32),
        scaling=np.repeat(_log_spacing(position)[:, None], 6, axis=1),
    )


def voxel_integers(points: npt.NDArray[np.floating], voxel: float) -> npt.NDArray[np.int64]:
    """Distinct voxels (A, 3) int64 that hold points (P, 3), ascending by (x, y, z).

    Raises:
        DataError: as :func:`initial_anchors`.
    """
    if not np.isfinite(points).all():
        raise DataError("start points: a coordinate is not finite; clean the data set's points")
    scaled = np.rint(np.asarray(points, np.float64) * (1.0 / voxel))
    _check_extent(scaled, voxel)
    integers = np.unique(scaled.astype(np.int64), axis=0)
    if len(integers) <= NEIGHBOURS:
        raise DataError(
            f"start points: {len(points)} points in {len(integers)} voxels of {voxel}, at least "
            f"{NEIGHBOURS + 1} needed; give more points or a smaller voxel"
        )
    return integers


def _check_extent(scaled: npt.NDArray[np.float64], voxel: float) -> None:
    """Refuse what 21 bits per axis, or float32 around the origin, cannot hold exactly."""
    limit = 2.0**GRID_BITS
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


def _log_spacing(position: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    points = position.astype(np.float64)
    distance, _ = cKDTree(points).query(points, k=NEIGHBOURS + 1)
    squared = np.square(distance[:, 1:]).mean(axis=1)
    return np.asarray(0.5 * np.log(np.maximum(squared, SQUARED_DISTANCE_FLOOR)), np.float32)
