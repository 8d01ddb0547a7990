"""Positions that lie on a coarser lattice: their differences share a factor on some axis.

Every level of an octree costs bits, even one that carries no information. So coordinates are
divided by the common factor first: q = c + (p - c) / f on each axis, with c the least p.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clgs.codec.octree import position_coder

SAMPLE = 64
"""Points that are tried first: mostly they show that there is no common factor."""

Ints = npt.NDArray[np.int32]


def common_factors(position: Ints) -> list[int]:
    """For each axis of (N, 3) int32, N > 0: the greatest factor of all differences, at least 1."""
    return [_common_factor(position[:, axis]) for axis in range(3)]


def _common_factor(column: Ints) -> int:
    for part in (column[:SAMPLE], column):
        factor = int(np.gcd.reduce(part.astype(np.int64) - int(part[0])))
        if factor == 1:
            return 1
    return max(factor, 1)


def shrink(position: Ints, factors: Sequence[int]) -> Ints:
    """The positions on the lattice, (N, 3) int32 in their own Morton order."""
    corner = np.array(position_coder.corners(position)[0])
    return position_coder.in_order((corner + (position - corner) // factors).astype(np.int32))


def grow(position: Ints, factors: Sequence[int]) -> Ints:
    """The mirror of :func:`shrink`: (N, 3) int32, N > 0, in Morton order.

    Raises:
        ValueError: a coordinate would leave int32.
        PositionsError: the extent reaches 2^21 on an axis.
    """
    corner = np.array(position_coder.corners(position)[0])
    grown = corner + (position - corner) * np.array(factors)
    if grown.max() > np.iinfo(np.int32).max:
        raise ValueError("the lattice leaves the range of int32")
    return position_coder.in_order(grown.astype(np.int32))
