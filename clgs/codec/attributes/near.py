"""The near rows of attribute rows: those before them whose positions are nearest."""

from __future__ import annotations

from threading import Lock

import numpy as np

from clgs import _codec
from clgs.codec.attributes.model import Ints

COUNT = 4
"""Near rows of a row."""


def find_near(position: Ints) -> Ints:
    """The near rows (n, COUNT) int32 of rows at ``position`` (n, 3) int32.

    The earlier rows at the least distance, nearest first, of equal distances the later ones; -1
    where there are fewer.

    Raises:
        ValueError: positions span 2^21 cells.
    """
    near = np.empty((len(position), COUNT), np.int32)
    _codec.attributes_near(np.ascontiguousarray(position, np.int32), near)
    return near


class NearRows:
    """The near rows of chunks at ``position`` (n, 3) int32, found when they are first asked for."""

    def __init__(self, position: Ints, chunks: list[slice]) -> None:
        self.position = position
        self._chunks = chunks
        self._found: list[Ints | None] = [None] * len(chunks)
        self._locks = [Lock() for _ in chunks]

    def of(self, index: int) -> Ints:
        """Near rows (rows of the chunk, COUNT) int32, counted from the chunk's first row."""
        with self._locks[index]:
            found = self._found[index]
            if found is None:
                found = find_near(self.position[self._chunks[index]])
                self._found[index] = found
            return found
