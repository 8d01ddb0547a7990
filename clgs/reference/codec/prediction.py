"""Predictions of attribute channels, for reading (FORMAT.md on residuals)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

NEAR, NEAR_ROWS, CLAMP = -4, 4, 32767


def near_rows(position: npt.NDArray[np.int32]) -> list[list[int]]:
    """The near rows of each row at ``position`` (n, 3) int32: at most four earlier rows.

    Those at the least distance, nearest first; of equal distances the later rows.
    """
    points = position.astype(np.int64)
    found = []
    for i in range(len(points)):
        distance = ((points[:i] - points[i]) ** 2).sum(axis=1)
        order = sorted(range(i), key=lambda row: (int(distance[row]), -row))
        found.append(order[:NEAR_ROWS])
    return found


def rows_before(count: int) -> list[list[int]]:
    """The near rows of rows without positions."""
    return [[i - k for k in range(1, NEAR_ROWS + 1) if k <= i] for i in range(count)]


def sum_of_terms(
    taps: Sequence[tuple[int, int, int]], values: list[list[int]], near: list[list[int]], i: int
) -> int:
    """The sum of all terms at row i and one half, in 1/1024."""
    rows, total = len(values[0]), 0
    for source, row, factor in taps:
        if row == NEAR:
            total += factor * sum(clamp(values[source][k]) for k in near[i])
        elif 0 <= i + row < rows:
            total += NEAR_ROWS * factor * clamp(values[source][i + row])
    return wrap(total + 512)


def rounded(total: int) -> int:
    """The prediction of a sum of terms."""
    return total >> 10


def wrapped_difference(value: int, total: int) -> int:
    """The residual of a mixed channel."""
    return wrap(value - rounded(total))


def residual_of(value: int, total: int) -> int:
    """With tables: value minus prediction, or the reverse if the prediction was rounded up."""
    residual = value - rounded(total)
    return wrap(residual if total & 512 else -residual)


def value_of(residual: int, total: int) -> int:
    """The value of such a residual."""
    return wrap(rounded(total) + (residual if total & 512 else -residual))


def clamp(value: int) -> int:
    """The value that predictions use."""
    return min(max(value, -CLAMP), CLAMP)


def wrap(value: int) -> int:
    """Modulo 2^32, as a signed number."""
    return (value + 2**31) % 2**32 - 2**31
