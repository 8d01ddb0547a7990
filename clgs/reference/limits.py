"""What the kernels that only use the device compute, in float64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def copy(source: Array) -> Array:
    """The same values."""
    return source.copy()


def fma(factor: float, term: float, steps: int, chains: int = 6) -> float:
    """Sum over the chains of x <- x factor + term, ``steps`` times, from (1 .. chains) / 8 on.

    By the closed form: x approaches term / (1 - factor) geometrically.
    """
    limit = term / (1 - factor)
    start = np.arange(1, chains + 1) / 8
    return float(np.sum(limit + (start - limit) * factor**steps))


def rounding(x: Array, y: Array, z: Array) -> Array:
    """(4, n): x / y, sqrt(y), x y + z rounded twice, and rounded once, all to float32.

    The arguments hold numbers of float32 with magnitudes from 1 to 4: x y and x y + z are exact in
    float64 then, and a quotient or root that float64 has rounded rounds on as if it were exact.
    """
    product = (x * y).astype(np.float32).astype(np.float64)
    return np.stack([x / y, np.sqrt(y), product + z, x * y + z]).astype(np.float32)
