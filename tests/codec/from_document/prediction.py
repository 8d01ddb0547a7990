"""7.2: near rows and predictions."""

from __future__ import annotations

import numpy as np

from tests.codec.from_document.common import wrap


class Prediction:
    """A prediction (7.2), of the sum of its terms and one half."""

    def __init__(self, total: int) -> None:
        self.rounded = total >> 10
        self.up = total % 1024 < 512
        self.eighths = total % 1024 // 128

    def value(self, residual: int) -> int:
        """The value that has this residual."""
        return wrap(self.rounded - residual if self.up else self.rounded + residual)


def near_rows(positions: list[list[int]]) -> list[list[int]]:
    """The near rows (7.2) of every row of a chunk."""
    points = np.array(positions, np.int64).reshape(-1, 3)
    near: list[list[int]] = []
    for i in range(len(points)):
        off = ((points[:i] - points[i]) ** 2).sum(axis=1)[::-1]
        near.append([i - 1 - int(k) for k in np.argsort(off, kind="stable")[:4]])
    return near


def rows_before(n: int) -> list[list[int]]:
    """The near rows of rows without positions."""
    return [list(range(i - 1, max(i - 5, -1), -1)) for i in range(n)]
