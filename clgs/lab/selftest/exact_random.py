"""Random numbers whose bits depend on nothing but this file: no library's generator, no rounding.

SplitMix64 (Steele, Lea and Flood 2014) gives the integers; floats are multiples of 2^-24 from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX = ((np.uint64(30), 0xBF58476D1CE4E5B9), (np.uint64(27), 0x94D049BB133111EB))


class ExactRandom:
    """A stream of random numbers from a seed."""

    def __init__(self, seed: int) -> None:
        self._state = np.uint64(seed)

    def integers(self, count: int) -> npt.NDArray[np.uint64]:
        """The next ``count`` integers, uniform over 64 bits."""
        steps = np.arange(1, count + 1, dtype=np.uint64)
        with np.errstate(over="ignore"):
            value = self._state + steps * GOLDEN
            self._state = self._state + np.uint64(count) * GOLDEN
            for shift, factor in MIX:
                value = (value ^ (value >> shift)) * np.uint64(factor)
        return np.asarray(value ^ (value >> np.uint64(31)))

    def floats(self, shape: Sequence[int], low: float, high: float) -> npt.NDArray[np.float32]:
        """float32 in [low, high): low + (high - low) k 2^-24, rounded once to float32."""
        unit = (self.integers(int(np.prod(shape))) >> np.uint64(40)).astype(np.float64) * 2.0**-24
        return (low + (high - low) * unit).astype(np.float32).reshape(tuple(shape))

    def bytes(self, shape: Sequence[int]) -> npt.NDArray[np.uint8]:
        """uint8 in [0, 256)."""
        high = self.integers(int(np.prod(shape))) >> np.uint64(56)
        return high.astype(np.uint8).reshape(tuple(shape))
