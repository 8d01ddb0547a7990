"""Rows by run lengths and the weights of the networks: 5.2 and parts 8 and 9 of FORMAT.md."""

from __future__ import annotations

import struct
from collections import defaultdict
from functools import partial

import numpy as np

from .coding import (
    ByteReader,
    NumberDecoder,
    RangeDecoder,
    State,
    check,
    clamp,
    decode_size,
    decode_value,
    in_int32,
    level,
    mix,
    small,
)

Rows = list[list[int]]
OUTPUTS = (10, 30, 70)
MATRICES = [shape for m in OUTPUTS for shape in ((50, 53), (50, 1), (m, 50), (m, 1))]
WEIGHTS = 13710


def _decode(data: bytes, n: int, columns: int, kind: type[RunRows] | type[PaperRows]) -> Rows:
    """Rows of either code: plain integers in mode 0, else means and the decisions of `kind`."""
    check(n <= 2**27 and columns <= 256, "too many rows or columns")
    reader = ByteReader(data)
    (mode,) = reader.fields("B")
    check(mode in (0, 1), f"rows of mode {mode}")
    if mode == 0:
        check(reader.left == 4 * n * columns, "rows of mode 0 of a wrong length")
        return [list(row) for row in struct.iter_unpack(f"<{columns}i", reader.rest())]
    check(n > 0, "mode 1 of no rows")
    means = [reader.varint() for _ in range(columns)]
    coder = RangeDecoder(reader.rest())
    rows = [
        [mean + v for mean, v in zip(means, row, strict=True)]
        for row in kind(coder, columns).rows(n)
    ]
    coder.finish()
    check(all(in_int32(v) for row in rows for v in row), "a value outside of int32")
    return rows


def decode_rows(data: bytes, n: int, columns: int) -> Rows:
    """The rows of integers of section CHNK (5.2)."""
    return _decode(data, n, columns, RunRows)


def decode_paper_rows(data: bytes, n: int, columns: int) -> Rows:
    """The rows of a plain run-length chunk (part 8)."""
    return _decode(data, n, columns, PaperRows)


class RunRows:
    """The decisions of mode 1 of 5.2."""

    def __init__(self, coder: RangeDecoder, columns: int) -> None:
        self.coder = coder
        self.columns = columns
        self.runs = NumberDecoder(coder, 250)
        self.plain: dict[tuple, State] = defaultdict(lambda: State(1000))
        self.other: dict[tuple, State] = defaultdict(lambda: State(250))
        self.weights: dict[tuple[int, int], list[int]] = defaultdict(lambda: 3 * [65536 // 3])

    def rows(self, n: int) -> Rows:
        """n rows, before the means are added."""
        rows: Rows = []
        zeros = self.columns * [0]
        last, before_last = zeros, zeros  # the two rows above, clamped
        while len(rows) < n:
            run = self.runs.size() - 1
            check(run <= n - len(rows), "a run past the end")
            if run:
                last, before_last = zeros, (zeros if run > 1 else last)
            rows += run * [zeros]
            if len(rows) < n:
                row = self.row(last, before_last)
                last, before_last = [clamp(v, -255, 255) for v in row], last
                rows.append(row)
        return rows

    def row(self, last: list[int], before_last: list[int]) -> list[int]:
        """One row that is not of a run."""
        row: list[int] = []
        for j in range(self.columns):
            left = [clamp(v, -255, 255) for v in row[max(j - 2, 0) :]]
            left = (2 - len(left)) * [0] + left
            space = ("space", j, level(last[j] + before_last[j]))
            cross = ("cross", j, level(left[1]), small(left[0]))
            decide = partial(self.decide, j, space, cross)
            row.append(decode_value(decide, self.coder.raw))
        return row

    def decide(self, j: int, space: tuple, cross: tuple, d: int) -> int:
        """Decision d of column j."""
        states = [self.plain[j, d], self.other[space, d], self.other[cross, d]]
        return mix(self.coder, states, self.weights[j, d], 14)


class PaperRows:
    """The decisions of part 8: groups of three columns, then of one."""

    def __init__(self, coder: RangeDecoder, columns: int) -> None:
        self.coder = coder
        self.columns = columns

    def rows(self, n: int) -> Rows:
        """n rows, before the means are added."""
        rows: Rows = [[] for _ in range(n)]
        while len(rows[0]) < self.columns:
            width = 3 if self.columns - len(rows[0]) >= 3 else 1
            PaperGroup(self.coder, width).append_to(rows)
        return rows


class PaperGroup:
    """A group of three columns, or of one, with its 31 probabilities."""

    def __init__(self, coder: RangeDecoder, width: int) -> None:
        self.coder = coder
        self.width = width
        self.run_p = 5 * [32768]
        self.a0 = 7 * [32768]
        self.a1 = 7 * [32768]
        self.prefix = [3 * [32768], 3 * [32768]]
        self.suffix = [3 * [32768], 3 * [32768]]

    def append_to(self, rows: Rows) -> None:
        """Decode the group, and append its values to the rows."""
        i = 0
        while i < len(rows):
            run = self.run(len(rows) - i)
            check(run <= len(rows) - i, "a run past the end")
            for _ in range(run):
                rows[i] += self.width * [0]
                i += 1
            if i < len(rows):
                rows[i] += self.row()
                i += 1

    def bit(self, probabilities: list[int], which: int) -> int:
        """A decision by one of the group's probabilities, which learns from it."""
        p = probabilities[which]
        bit = self.coder.decode(p)
        probabilities[which] = p + (65536 - p >> 5) if bit else p - (p >> 5)
        return bit

    def run(self, most: int) -> int:
        """The number L of rows that are all 0."""
        for length in range(3):
            if not self.bit(self.run_p, length):
                return length
        for k in (3, 5, 7, 9):
            if not self.bit(self.run_p, 3):
                return k + self.coder.raw()
        x, k = 11, 2
        while k < 32 and self.bit(self.run_p, 4):
            x += 1 << k
            k += 1
            check(x <= most, "a run past the end")
        return x + self.coder.raw(k)

    def magnitude(self, which0: int, which1: int, exp_set: int) -> int:
        """A magnitude by a0[which0], a1[which1] and an Exp-Golomb code of order 1."""
        if not self.bit(self.a0, which0):
            return 0
        if not self.bit(self.a1, which1):
            return 1
        x, k = 2, 1
        while k < 32 and self.bit(self.prefix[exp_set], min(k - 1, 2)):
            x += 1 << k
            k += 1
        for place in reversed(range(k)):
            x += self.bit(self.suffix[exp_set], min(place, 2)) << place
        return x

    def row(self) -> list[int]:
        """A row that is not all 0."""
        if self.width == 1:
            magnitudes = [self.magnitude(0, 0, 0) + 1]
        else:
            m1 = self.magnitude(0, 0, 1)
            m2 = self.magnitude(1 + (m1 == 0), 1 + (m1 <= 1), 1)
            which0 = 3 + 2 * (m1 == 0) + (m2 == 0)
            which1 = 3 + 2 * (m1 <= 1) + (m2 <= 1)
            m0 = self.magnitude(which0, which1, 0) + (m1 == m2 == 0)
            magnitudes = [m0, m1, m2]
        return [-m if m and self.coder.raw() else m for m in magnitudes]


def decode_weights(data: bytes, matrices: list[tuple[int, int]] | None = None) -> np.ndarray:
    """The weights of the three networks as f32 (part 9); other `matrices` are for examples."""
    matrices = MATRICES if matrices is None else matrices
    count = sum(rows * columns for rows, columns in matrices)
    reader = ByteReader(data)
    (mode,) = reader.fields("B")
    check(mode in (0, 1, 2), f"MLPS: mode {mode}")
    if mode == 0:
        check(reader.left == 4 * count, "MLPS: mode 0 of a wrong length")
        weights = np.frombuffer(reader.rest(), "<f4").copy()
    elif mode == 1:
        weights = _decode_planes(reader.rest(), count)
    else:
        steps = list(reader.take(len(matrices)))
        check(255 not in steps, "MLPS: step 255")
        weights = MultiplesDecoder(reader.rest()).decode(matrices, steps)
    check(bool(np.isfinite(weights).all()), "MLPS: a weight is not finite")
    return weights


def _decode_planes(data: bytes, count: int) -> np.ndarray:
    """Mode 1 (9.1)."""
    coder = RangeDecoder(data)
    plain: dict[tuple, State] = defaultdict(lambda: State(250))
    joint: dict[tuple, State] = defaultdict(lambda: State(250))
    weights: dict[tuple, list[int]] = defaultdict(lambda: [32768, 32768])
    words = []
    last_top = 0
    for _ in range(count):
        word = 0  # the bytes so far
        for plane in range(4):
            if plane == 0:
                context = last_top
            elif plane == 1:
                context = word
            else:
                context = word >> 8 * plane - 9 & 255  # bits 30 to 23 of the whole word
            node = 1
            for _ in range(8):
                states = [plain[plane, node], joint[plane, node, context]]
                node = node << 1 | mix(coder, states, weights[plane, node], 14)
            word = word << 8 | node & 255
        last_top = word >> 24
        words.append(word)
    coder.finish()
    return np.array(words, "<u4").view("<f4")


class MultiplesDecoder:
    """Mode 2 (9.2)."""

    def __init__(self, data: bytes) -> None:
        self.coder = RangeDecoder(data)
        self.states: dict[tuple[int, int], State] = defaultdict(lambda: State(1000))
        self.weights: dict[int, list[int]] = defaultdict(lambda: [65536])

    def decode(self, matrices: list[tuple[int, int]], steps: list[int]) -> np.ndarray:
        """The weights of all matrices."""
        weights: list[float] = []
        for (rows, columns), step in zip(matrices, steps, strict=True):
            if step == 0:
                weights += rows * columns * [0.0]
            else:
                weights += [n * 2.0 ** (step - 150) for n in self.matrix(rows, columns)]
        self.coder.finish()
        return np.array(weights, "<f4")

    def matrix(self, rows: int, columns: int) -> list[int]:
        """The multiples n of one matrix."""
        numbers: list[int] = []
        total = 0
        column_sums = columns * [0]
        for i in range(rows):
            row_sum = before = 0
            for j in range(columns):
                mean = 16 * (total + 32) // (len(numbers) + 1)
                column = (16 * column_sums[j] + 16 * mean) // (i + 16)
                ratio = 256 * (16 * row_sum + 48 * mean + 1) // (before + 48 * mean + 1)
                n = self.number(max(1, column * min(65535, ratio) // 256))
                numbers.append(n)
                total += abs(n)
                column_sums[j] += abs(n)
                row_sum += abs(n)
                before += column
        return numbers

    def number(self, expected: int) -> int:
        """A multiple whose magnitude is expected to be expected / 16."""
        t = expected.bit_length() - 1
        k = min(23, max(0, t - 5))
        kind = 4 * min(t, 6) + (4 * expected >> t & 3)

        def decide(d: int) -> int:
            return mix(self.coder, [self.states[kind, d]], self.weights[d], 14)

        high = decode_size(decide, self.coder.raw) - 1
        check(high < 1 << 24 - k, "MLPS: a multiple of 2^24 or more")
        magnitude = high << k | self.coder.raw(k)
        return -magnitude if magnitude and self.coder.raw() else magnitude
