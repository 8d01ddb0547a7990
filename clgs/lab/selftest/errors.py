"""Distances between a device's results and the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def largest(actual: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """Largest absolute difference; infinite for different shapes, NaN spreads."""
    if actual.shape != expected.shape:
        return float("inf")
    return float(np.max(np.abs(actual.astype(np.float64) - expected), initial=0.0))


def relative_l2(actual: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """||actual - expected|| / ||expected||; infinite for different shapes, NaN spreads."""
    if actual.shape != expected.shape:
        return float("inf")
    norm = float(np.linalg.norm(np.asarray(expected, np.float64)))
    error = float(np.linalg.norm(actual.astype(np.float64) - expected))
    return error / norm if norm else error
