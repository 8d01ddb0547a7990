"""Compare arrays so that a NaN fails and the worst element is named."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


def assert_close(actual: Array, expected: Array, bound: Any, name: str = "array") -> None:
    """Every |actual - expected| is at most ``bound`` (a number, or an array that broadcasts).

    NaN or infinity on either side fails. The message names the worst element: the one that
    exceeds its bound by the largest factor.
    """
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape, f"{name}: shape {actual.shape}, not {expected.shape}"
    if actual.size == 0:
        return
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.abs(actual.astype(np.float64) - expected.astype(np.float64))
        limit = np.broadcast_to(np.asarray(bound, np.float64), error.shape)
        good = error <= limit
        excess = np.where(good, -1.0, np.nan_to_num(error / limit, nan=np.inf))
    if good.all():
        return
    worst = np.unravel_index(int(np.argmax(excess)), error.shape)
    index = tuple(int(i) for i in worst)
    raise AssertionError(
        f"{name}[{', '.join(map(str, index))}]: {actual[index]!r}, expected {expected[index]!r}, "
        f"error {error[index]:.3g} > {limit[index]:.3g}; {int((~good).sum())} of {good.size} fail"
    )


def relative_l2(actual: Array, expected: Array) -> float:
    """||actual - expected|| / ||expected|| in float64; 0 for two zero arrays, NaN spreads."""
    actual, expected = np.asarray(actual, np.float64), np.asarray(expected, np.float64)
    assert actual.shape == expected.shape, f"shape {actual.shape}, not {expected.shape}"
    error, norm = np.linalg.norm(actual - expected), np.linalg.norm(expected)
    if norm == 0.0:
        return 0.0 if error == 0.0 else float("inf") if error > 0.0 else float("nan")
    return float(error / norm)


def central_difference(
    function: Callable[[Array], float],
    x: Array,
    step: float = 1e-6,
    indices: Iterable[Any] | None = None,
) -> Array:
    """d function / d x by central differences in float64, at ``indices`` (default: all).

    The step is ``step * max(1, |x|)``, element by element. Returns one number an index, in order.
    """
    x = np.array(x, np.float64)
    chosen = list(np.ndindex(x.shape)) if indices is None else list(indices)
    slopes = []
    for index in chosen:
        centre = x[index]
        width = step * max(1.0, abs(centre))
        values = []
        for moved in (centre + width, centre - width):
            x[index] = moved
            values.append((float(function(x)), moved))
        x[index] = centre
        slopes.append((values[0][0] - values[1][0]) / (values[0][1] - values[1][1]))
    return np.array(slopes)
