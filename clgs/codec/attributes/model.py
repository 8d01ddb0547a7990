"""The model of attribute channels as an array, and the near rows that its predictions look at.

The layout is that of codec_c/src/attributes/model.h.
"""

from __future__ import annotations

from threading import Lock
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from clgs import _codec

Ints: TypeAlias = npt.NDArray[np.int32]
Models: TypeAlias = npt.NDArray[Any]

TAPS, CELLS, CLASSES, TABLE, SCALE = 16, 64, 16, 256, 4096
MIXED, KNOWN = 1, 2
"""Coders other than tables (0); a reader has the values of known channels already."""

NEAR = -4
"""The row of a tap that looks at the near rows: those before it whose positions are nearest."""

NEAR_COUNT = 4
"""How many near rows a row has."""

MAX_FACTOR, TAP_CLAMP, MAX_GAIN, MAX_WEIGHT = 2047, 32767, 65535, 8191

CHANNEL = np.dtype(
    [
        ("centre", np.int32),
        ("taps", np.int32),
        ("tap", np.int32, (TAPS, 3)),
        ("gain", np.int32),
        ("weight", np.int32, 3),
        ("span", np.int32),
        ("coder", np.int32),
        ("classes", np.int32),
        ("class_of", np.uint8, CELLS),
        ("frequency", np.uint16, (CLASSES, TABLE)),
    ]
)
"""``clgs_channel``. A tap is (channel, row, factor).

The three weights are of the own column, of the row, and of the rows above and below it.
"""


def empty_model(channels: int) -> Models:
    """A model (channels,) in which every channel is always 0."""
    model = np.zeros(channels, CHANNEL)
    model["classes"], model["frequency"][:, 0, 0] = 1, SCALE
    return model


def looks_near(model: Models) -> bool:
    """Whether a tap of ``model`` looks at near rows."""
    used = np.arange(TAPS) < model["taps"][:, None]
    return bool((used & (model["tap"][:, :, 1] == NEAR)).any())


def find_near(position: Ints) -> Ints:
    """The near rows (n, NEAR_COUNT) int32 of rows at ``position`` (n, 3) int32.

    They are the earlier rows at the least distance, nearest first; of equal distances, the later
    ones come first. -1 stands for a row that does not exist.

    Raises:
        ValueError: positions span 2^21 cells.
    """
    near = np.empty((len(position), NEAR_COUNT), np.int32)
    _codec.attributes_near(np.ascontiguousarray(position, np.int32), near)
    return near


class NearRows:
    """The near rows of the chunks of rows at ``position`` (n, 3) int32, found on first use."""

    def __init__(self, position: Ints, chunks: list[slice]) -> None:
        self.position = position
        self._chunks = chunks
        self._found: list[Ints | None] = [None] * len(chunks)
        self._locks = [Lock() for _ in chunks]

    def of(self, index: int) -> Ints:
        """Near rows (rows of the chunk, NEAR_COUNT) int32, counted from the chunk's first row."""
        with self._locks[index]:
            found = self._found[index]
            if found is None:
                found = find_near(self.position[self._chunks[index]])
                self._found[index] = found
            return found
