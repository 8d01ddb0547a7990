"""Parts of space: what is kept of a scene, or what learns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.errors import UsageError


@dataclass(frozen=True)
class Box:
    """lower <= x < upper on every axis; ends may be infinite. Units are those of the points.

    Raises:
        UsageError: not three ends each, one is not a number, or a lower is not below its upper.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not len(self.lower) == len(self.upper) == 3:
            raise UsageError("box: give three lower and three upper ends")
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise UsageError(f"box: {axis} from {low:g} to {high:g} is empty; lower end first")

    def holds(self, points: npt.NDArray[np.number]) -> npt.NDArray[np.bool_]:
        """Whether each of ``points`` (N, 3) lies in the box; NaN does not."""
        return np.asarray(((points >= self.lower) & (points < self.upper)).all(axis=1))

    def meets(
        self, least: npt.NDArray[np.float64], greatest: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        """Whether each of the closed boxes with these corners (N, 3) has a point in this one."""
        return np.asarray(((greatest >= self.lower) & (least < self.upper)).all(axis=1))


@dataclass(frozen=True)
class Sphere:
    """All points within ``radius`` of ``centre``, in the units of the input data.

    Raises:
        UsageError: the radius is not above 0, or a number is not finite.
    """

    centre: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        if not (np.isfinite([*self.centre, self.radius]).all() and self.radius > 0):
            shown = ",".join(f"{value:g}" for value in (*self.centre, self.radius))
            raise UsageError(f"sphere: {shown} is none; give a centre and a radius above 0")

    def holds(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Whether each of ``points`` (N, 3) lies in the sphere or on it."""
        # In units of the radius, so that squares of large numbers do not overflow.
        away = points / self.radius - np.asarray(self.centre) / self.radius
        near = np.abs(away).max(axis=1, initial=0) <= 1
        near[near] = np.linalg.norm(away[near], axis=1) <= 1
        return np.asarray(near)
