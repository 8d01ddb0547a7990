"""Rows of CHNK as runs of equal rows, for reading (FORMAT.md on CHNK); same bytes as C."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from clgs.reference.codec.coding import (
    WEIGHT_ONE,
    Coder,
    RangeDecoder,
    RangeEncoder,
    State,
    code_mixed,
)
from clgs.reference.codec.varint import read_varint, varint

SLOW_LIMIT, FAST_LIMIT, SHIFT = 1000, 250, 14
CLAMP = 255
TREES = {2: (16, 1), 3: (17, 2), 4: (20, 3), 5: (27, 4), 6: (42, 5), 7: (73, 4), 8: (88, 4)}
"""For each length in bits: first node of the tree of leading bits, and its depth."""
LONG_TREE = (103, 3)
CORRUPT = "the stream holds what no encoder writes"


class Symbol:
    """Spells integers by binary decisions; every node has a state per context, and weights."""

    def __init__(self, limits: tuple[int, ...]) -> None:
        self.states: dict[tuple[int, ...], State] = {}
        self.limits = limits
        start = WEIGHT_ONE // len(limits)
        self.weights: dict[int, list[int]] = defaultdict(lambda: [start] * len(limits))
        self.contexts: tuple[int, ...] = (0,) * len(limits)

    def bit(self, coder: Coder, node: int, bit: int) -> int:
        """Code one decision in the current contexts."""
        states = [
            self.states.setdefault((i, context, node), State(limit))
            for i, (context, limit) in enumerate(zip(self.contexts, self.limits, strict=True))
        ]
        return code_mixed(coder, bit, states, self.weights[node], SHIFT)

    def size(self, coder: Coder, size: int) -> int:
        """Code ``size`` in [1, 2^32): its length in bits, then the bits below the top one."""
        length = 1
        while length < 32 and self.bit(coder, 1 + min(length, 14), int(size.bit_length() > length)):
            length += 1
        if length == 1:
            return 1
        first, depth = TREES.get(length, LONG_TREE)
        prefix = 1
        for place in range(length - 2, -1, -1):
            bit = size >> place & 1
            if length - 2 - place < depth:
                bit = self.bit(coder, first + prefix - 1, bit)
            else:
                bit = coder.code(bit, 32768)
            prefix = prefix << 1 | bit
        return prefix

    def value(self, coder: Coder, value: int) -> int:
        """Code a signed integer."""
        if not self.bit(coder, 0, int(value != 0)):
            return 0
        negative = self.bit(coder, 1, int(value < 0))
        size = self.size(coder, abs(value))
        return -size if negative else size


def encode(value: npt.NDArray[np.int32]) -> bytes:
    """The run-length stream of ``value`` (rows, channels) int32."""
    rows = [[int(x) for x in row] for row in value]
    raw = b"\0" + np.asarray(value, "<i4").tobytes()
    if not rows:
        return raw
    centres = [_find_centre(column) for column in zip(*rows, strict=True)]
    coder = RangeEncoder()
    _code_rows(coder, centres, len(rows), rows)
    coded = b"\1" + b"".join(map(varint, centres)) + coder.finish()
    return coded if len(coded) <= len(raw) else raw


def decode(data: bytes, rows: int, channels: int) -> npt.NDArray[np.int32]:
    """The matrix (rows, channels) int32.

    Raises:
        ValueError: the stream is damaged.
    """
    if data[0] == 0:
        return np.frombuffer(data, "<i4", rows * channels, offset=1).reshape(rows, channels)
    centres, at = [], 1
    for _ in range(channels):
        centre, at = read_varint(data, at)
        centres.append(centre)
    coder = RangeDecoder(data[at:])
    decoded = _code_rows(coder, centres, rows, None)
    coder.finish()
    return np.array(decoded, np.int32).reshape(rows, channels)


def _code_rows(
    coder: Coder, centres: list[int], count: int, rows: list[list[int]] | None
) -> list[list[int]]:
    """Code ``count`` rows as runs of rows equal to ``centres``, each followed by another row."""
    symbols = [Symbol((SLOW_LIMIT, FAST_LIMIT, FAST_LIMIT)) for _ in centres]
    runs = Symbol((FAST_LIMIT,))
    done: list[list[int]] = []
    before = [[0] * len(centres), [0] * len(centres)]
    while len(done) < count:
        run = 0
        while rows and len(done) + run < count and rows[len(done) + run] == centres:
            run += 1
        run = runs.size(coder, run + 1) - 1
        if run > count - len(done):
            raise ValueError(CORRUPT)
        done += [list(centres)] * run
        before = ([[0] * len(centres)] * min(run, 2) + before)[:2]
        if len(done) < count:
            row = rows[len(done)] if rows else centres
            residuals = [x - centre for x, centre in zip(row, centres, strict=True)]
            residuals = _code_row(coder, symbols, before, residuals)
            done.append([x + c for x, c in zip(residuals, centres, strict=True)])
            before = [[_clamp(x) for x in residuals], before[0]]
        if not all(-(2**31) <= x < 2**31 for x in done[-1]):
            raise ValueError(CORRUPT)
    return done


def _code_row(
    coder: Coder, symbols: list[Symbol], before: list[list[int]], row: list[int]
) -> list[int]:
    """Code one row of differences; contexts: the two rows before, the two channels before."""
    coded: list[int] = []
    for j, symbol in enumerate(symbols):
        left = [_clamp(coded[k]) if k >= 0 else 0 for k in (j - 1, j - 2)]
        cross = 4 * level(left[0]) + small_level(left[1])
        symbol.contexts = (0, level(before[0][j] + before[1][j]), cross)
        coded.append(symbol.value(coder, row[j]))
    return coded


def level(value: int) -> int:
    """Class of a neighbour: |value| of 0, 1, 2, 3-4, 5-8, 9-16, 17-32, above; + 8 if negative."""
    size = sum(abs(value) > limit for limit in (0, 1, 2, 4, 8, 16, 32))
    return size + 8 if value < 0 else size


def small_level(value: int) -> int:
    """Class of a neighbour: |value| of 0, 1-2, 3-8, above."""
    return sum(abs(value) > limit for limit in (0, 2, 8))


def _find_centre(column: tuple[int, ...]) -> int:
    """0 if a quarter of the values are 0, otherwise the mean, halves rounded up."""
    if 4 * column.count(0) >= len(column):
        return 0
    return (2 * sum(column) + len(column)) // (2 * len(column))


def _clamp(value: int) -> int:
    return min(max(value, -CLAMP), CLAMP)
