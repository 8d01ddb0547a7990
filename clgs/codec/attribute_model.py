"""The model of attribute channels as an array, and the linear predictions that it is made of.

The layout is that of codec_c/src/attributes/model.h. Predictions look at near rows, earlier rows
and earlier channels. A tap is a term: the offset of a row, a channel, a factor. Terms are chosen
one by one: each time the one that explains most of what is left (orthogonal matching pursuit). Sums
of products are integers below 2^53 and so exact in any order; all other arithmetic is a fixed
sequence of IEEE 754 operations, so every machine finds the same terms.
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
MIXED, KNOWN, SIDED = 1, 2, 3
"""Coders other than tables (0). A reader has the values of known channels already; those of sided
ones have tables that their terms choose.
"""

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


Floats = npt.NDArray[np.float64]

ROWS = (0, -1, 1, -2)
"""Offsets of rows that are tried in earlier channels; negative ones in the channel itself, too."""

NEAR_ROWS = (0, NEAR)
"""The rows that are tried if rows have positions."""

LEAST_GAIN = 0.003
"""A term must explain this part of what is left of a channel's variance."""

LEAST_LEFT = 1e-6
"""Terms are added while more than this part of the variance is left."""

TILE, TILE_ROWS = 32, 256
"""Columns and rows of a tile of products: OpenBLAS takes up to 2^18 of them in one thread."""

FACTOR = 256
"""Factors are stored in units of 1/256."""


def find_taps(model: Models, sample: Ints, near: Ints | None) -> None:
    """Set the terms of every channel of ``model``, for values ``sample`` (n, channels).

    ``near`` (n, NEAR_COUNT) has the near rows, or is None if the rows have no positions.
    """
    channels = len(model)
    rows = ROWS if near is None else NEAR_ROWS
    products = _products(sample.astype(np.int64) - model["centre"], near)
    for j in range(channels):
        allowed = np.zeros((len(rows), channels), bool)
        allowed[:, :j] = True
        allowed[:, j] = np.array(rows) < 0
        _set_taps(model, j, products, j, np.flatnonzero(allowed), rows)


def find_sides(model: Models, sample: Ints, near: Ints, step: int, most: int) -> None:
    """Set the terms of sided channels: how far a prediction is from what is known.

    Channels of odd number have what is left of values divided by ``step``, those before them the
    quotients. A value is predicted as by :func:`find_taps`, by ``most`` terms or fewer, but not
    from its own quotient, step times which is then taken off. Other arguments as there.
    """
    channels = len(model)
    products = _products(sample.astype(np.int64) - model["centre"], near)
    values = np.zeros((channels // 2, channels))  # quotients and what is left, added up
    values[:, ::2][:, : channels // 2] = step * np.eye(channels // 2)
    values[:, 1::2] = np.eye(channels // 2)
    crossed = values @ products[:channels]
    whole = crossed[:, :channels] @ values.T
    products = np.block([[products, crossed.T], [crossed, whole]])
    for i in range(channels // 2):
        allowed = np.zeros((len(NEAR_ROWS), channels), bool)
        allowed[:, : 2 * i] = True
        allowed[1, 2 * i] = True
        j, candidates = 2 * i + 1, np.flatnonzero(allowed)
        taps = _set_taps(model, j, products, 2 * channels + i, candidates, NEAR_ROWS, most)
        model["tap"][j, taps] = 2 * i, 0, -step * FACTOR
        model["taps"][j] = taps + 1


def _set_taps(
    model: Models,
    j: int,
    products: Floats,
    target: int,
    candidates: npt.NDArray[np.intp],
    rows: tuple[int, ...],
    most: int = TAPS,
) -> int:
    """Set the terms of channel j that explain column ``target``; returns their number."""
    chosen = _pursue(products, candidates, target, most)
    factors = _solve(products, chosen, target)
    taps = [(int(c), f) for c, f in zip(chosen, factors, strict=True) if f != 0]
    model["taps"][j] = len(taps)
    for t, (c, factor) in enumerate(taps):
        model["tap"][j, t] = c % len(model), rows[c // len(model)], factor
    return len(taps)


def _products(value: npt.NDArray[np.int64], near: Ints | None) -> Floats:
    """Sums of products of all pairs of candidates; candidate row * channels + column.

    The matrix is summed in tiles that BLAS does not share out among threads of its own: attributes
    are fitted in several threads already, and those of BLAS wait by spinning.
    """
    clamped = np.clip(value, -TAP_CLAMP, TAP_CLAMP).astype(np.float64)
    if near is not None:
        around = np.zeros_like(clamped)
        for k in range(NEAR_COUNT):
            around[k + 1 :] += clamped[near[k + 1 :, k]]
        stacked = np.concatenate([clamped, around / NEAR_COUNT], axis=1)
    else:
        inner = max(len(clamped) - 3, 0)
        stacked = np.concatenate([clamped[2 + row : 2 + row + inner] for row in ROWS], axis=1)
    columns = stacked.shape[1]
    products = np.zeros((columns, columns))
    for first in range(0, len(stacked), TILE_ROWS):
        rows = stacked[first : first + TILE_ROWS]
        for i in range(0, columns, TILE):
            for j in range(i, columns, TILE):
                tile = rows[:, i : i + TILE].T @ rows[:, j : j + TILE]
                products[i : i + TILE, j : j + TILE] += tile
    return np.asarray(np.triu(products) + np.triu(products, 1).T)


def _pursue(products: Floats, candidates: npt.NDArray[np.intp], j: int, most: int) -> list[int]:
    """The ``most`` candidates or fewer that explain column j; the best comes first."""
    chosen: list[int] = []
    square = products[candidates, candidates]
    with_target = products[candidates, j]
    target = products[j, j]
    if len(candidates) == 0 or target == 0:
        return chosen
    directions: list[Floats] = []
    lengths: list[float] = []
    while len(chosen) < most:
        usable = square > 1e-9 * products[candidates, candidates]
        explained = np.where(usable, with_target, 0.0) ** 2 / np.where(usable, square, 1.0)
        best = int(np.argmax(explained))
        if explained[best] < LEAST_GAIN * target or target < LEAST_LEFT * products[j, j]:
            break
        row = products[candidates, candidates[best]].copy()
        for direction, length in zip(directions, lengths, strict=True):
            row -= direction * (direction[best] / length)
        directions.append(row)
        lengths.append(float(row[best]))
        target -= float(explained[best])
        with_target = with_target - row * (with_target[best] / row[best])
        square = square - row * row / row[best]
        chosen.append(int(candidates[best]))
    return chosen


def _solve(products: Floats, chosen: list[int], j: int) -> list[int]:
    """Factors in 1/256 that leave the least squares, by elimination of the normal equations."""
    size = len(chosen)
    rows = [[float(products[a, b]) for b in chosen] + [float(products[a, j])] for a in chosen]
    for p in range(size):
        for r in range(p + 1, size):
            ratio = rows[r][p] / rows[p][p]
            rows[r] = [x - ratio * y for x, y in zip(rows[r], rows[p], strict=True)]
    factors = [0.0] * size
    for p in reversed(range(size)):
        rest = sum(rows[p][q] * factors[q] for q in range(p + 1, size))
        factors[p] = (rows[p][size] - rest) / rows[p][p]
    return [min(max(round(f * FACTOR), -MAX_FACTOR), MAX_FACTOR) for f in factors]
