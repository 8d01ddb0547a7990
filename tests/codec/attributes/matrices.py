"""Integer matrices for the tests of attribute coders."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

INT32 = st.integers(-(2**31), 2**31 - 1)


def laplace(spread: float, rows: int = 60, channels: int = 7) -> np.ndarray:
    rng = np.random.default_rng(round(spread * 10))
    value = np.rint(rng.laplace(spread / 3, spread, (rows, channels)))
    value = np.clip(value, -(2**31), 2**31 - 1).astype(np.int32)
    value[rows // 3 : rows // 2] = 0
    return value


def matrices() -> dict[str, np.ndarray]:
    extremes = np.tile(np.array([[-(2**31)], [2**31 - 1], [0], [1]], np.int32), (5, 3))
    return {
        **{f"laplace {spread}": laplace(spread) for spread in (0.1, 1, 20, 1e3, 1e6, 5e8)},
        "extremes": extremes,
        "shifted": laplace(2) + 2**30,
        "constant": np.full((30, 2), -77, np.int32),
        "zeros": np.zeros((1000, 3), np.int32),
        "one value": np.array([[-(2**31)]], np.int32),
        "no rows": np.empty((0, 5), np.int32),
        "smooth": (np.arange(120).reshape(40, 3) ** 2 // 40).astype(np.int32),
    }
