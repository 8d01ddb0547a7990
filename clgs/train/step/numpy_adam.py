"""Adam in in-place float32 NumPy; the same numbers as the fused kernel of ``clgs.ops.adam``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.ops.adam import (
    BETA1,
    BETA2,
    EPSILON,
    MIN_FIRST_MOMENT,
    MIN_SECOND_MOMENT,
    factors,
)

Array = npt.NDArray[np.float32]


class Adam:
    """The optimiser state of one parameter group of shape (rows, ...).

    ``count`` is the number of updates made; it is kept when rows come and go.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.first: Array = np.zeros(shape, np.float32)
        self.second: Array = np.zeros(shape, np.float32)
        self.count = 0
        self._scratch: Array = np.empty(shape, np.float32)

    def step(
        self,
        parameter: Array,
        gradient: Array,
        learning_rate: float,
        moved: npt.NDArray[np.bool_] | None = None,
    ) -> None:
        """Update ``parameter`` in place from ``gradient``, both float32 of the group's shape.

        With ``moved`` (rows,) only those rows change, and only their moments.

        Raises:
            ValueError: a shape or dtype differs.
        """
        for name, array in (("parameter", parameter), ("gradient", gradient)):
            if array.shape != self.first.shape or array.dtype != np.float32:
                raise ValueError(
                    f"{name}: {array.dtype}{array.shape}, expected float32{self.first.shape}"
                )
        if moved is not None:
            self._step_rows(parameter, gradient, learning_rate, moved)
            return
        self.count += 1
        now = factors(learning_rate, self.count)
        self._update_moments(gradient)
        scratch = self._scratch
        np.sqrt(self.second, out=scratch)
        scratch *= np.float32(now.correction)
        scratch += np.float32(EPSILON)
        np.divide(self.first, scratch, out=scratch)
        scratch *= np.float32(now.step)
        parameter -= scratch

    def _step_rows(
        self,
        parameter: Array,
        gradient: Array,
        learning_rate: float,
        moved: npt.NDArray[np.bool_],
    ) -> None:
        part = Adam(gradient[moved].shape)
        part.first, part.second, part.count = self.first[moved], self.second[moved], self.count
        rows = parameter[moved]
        part.step(rows, gradient[moved], learning_rate)
        parameter[moved] = rows
        self.first[moved], self.second[moved] = part.first, part.second
        self.count = part.count

    def _update_moments(self, gradient: Array) -> None:
        scratch = self._scratch
        self.first *= np.float32(BETA1)
        np.multiply(gradient, np.float32(1.0 - BETA1), out=scratch)
        self.first += scratch
        self.second *= np.float32(BETA2)
        with np.errstate(under="ignore", over="ignore"):
            np.multiply(gradient, gradient, out=scratch)
        scratch *= np.float32(1.0 - BETA2)
        self.second += scratch
        # a product with 0 or 1 flushes without a temporary, and keeps a NaN
        np.abs(self.first, out=scratch)
        np.greater_equal(scratch, np.float32(MIN_FIRST_MOMENT), out=scratch)
        self.first *= scratch
        np.greater_equal(self.second, np.float32(MIN_SECOND_MOMENT), out=scratch)
        self.second *= scratch

    def keep(self, rows: npt.NDArray[np.generic]) -> None:
        """Keep the moments of some rows: a mask (rows,) or indices."""
        self._replace(self.first[rows], self.second[rows])

    def append(self, rows: int) -> None:
        """Add ``rows`` rows with zero moments."""
        zeros = np.zeros((rows, *self.first.shape[1:]), np.float32)
        self._replace(np.concatenate([self.first, zeros]), np.concatenate([self.second, zeros]))

    def _replace(self, first: Array, second: Array) -> None:
        self.first, self.second = first, second
        self._scratch = np.empty_like(first)
