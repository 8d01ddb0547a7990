"""Exclusive prefix sum in 64-bit integers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def exclusive(counts: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.int64], int]:
    """Offsets (n,): the sum of the counts before each one; and the sum of all."""
    ends = np.cumsum(counts, dtype=np.int64)
    return ends - counts, int(ends[-1]) if len(ends) else 0
