"""Adam in float64, as Kingma and Ba (2015) write it, epsilon added to the corrected root."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def step(
    parameter: Array,
    gradient: Array,
    moments: tuple[Array, Array],
    learning_rate: float,
    count: int,
    moved: npt.NDArray[np.bool_] | bool = True,
    betas: tuple[float, float] = (0.9, 0.999),
) -> tuple[Array, tuple[Array, Array]]:
    """The parameter and its moments after update number ``count`` (from 1).

    Elements that are not ``moved`` keep all three. ``betas``: what the moments keep of themselves.
    """
    first = betas[0] * moments[0] + (1 - betas[0]) * gradient
    second = betas[1] * moments[1] + (1 - betas[1]) * gradient**2
    mean = first / (1 - betas[0] ** count)
    deviation = np.sqrt(second / (1 - betas[1] ** count))
    stepped = parameter - learning_rate * mean / (deviation + 1e-15)
    kept = np.where(moved, first, moments[0]), np.where(moved, second, moments[1])
    return np.where(moved, stepped, parameter), kept


def average(parameters: list[Array]) -> Array:
    """The mean of parameters of one shape."""
    return np.asarray(np.mean(parameters, axis=0))
