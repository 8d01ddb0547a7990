"""Stable sort by integer key."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def by_key(
    keys: npt.NDArray[np.uint32], values: npt.NDArray[np.int32], bits: int = 32
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Keys (n,) and values (n,) ascending by the low ``bits`` bits; ties keep their order."""
    order = np.argsort(keys.astype(np.uint64) % 2**bits, kind="stable")
    return keys[order], values[order]


def chosen(keys: npt.NDArray[np.uint32], choice: npt.NDArray[np.int32]) -> npt.NDArray[Any]:
    """Indices of the items with choice (n,) > 0, ascending by key (n,), then by index."""
    index = np.flatnonzero(choice > 0)
    return np.asarray(index[np.argsort(keys[index], kind="stable")])
