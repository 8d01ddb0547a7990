"""Integers in rows: the code of 5.2, and the plain run-length chunks of part 8."""

from __future__ import annotations

import struct
from collections import defaultdict
from functools import partial

from tests.codec.from_document.common import ByteReader, check, clamp, in_int32
from tests.codec.from_document.entropy import (
    RangeDecoder,
    SoloNumbers,
    State,
    decode_value,
    level,
    mix,
    small,
)

Rows = list[list[int]]


def _plain_rows(data: bytes, n: int, columns: int, what: str) -> Rows:
    """Mode 0: n * columns values, i32."""
    check(len(data) == 4 * n * columns, f"{what}: mode 0 of a wrong length")
    return [list(row) for row in struct.iter_unpack(f"<{columns}i", data)]


def decode_rows(data: bytes, n: int, columns: int, what: str) -> Rows:
    """Rows of integers (5.2)."""
    check(n <= 2**27 and columns <= 256, f"{what}: too many rows or columns")
    reader = ByteReader(data, what)
    mode = reader.number("B")
    check(mode in (0, 1), f"{what}: mode {mode}")
    if mode == 0:
        return _plain_rows(reader.rest(), n, columns, what)
    check(n > 0, f"{what}: mode 1 of no rows")
    centres = [reader.varint() for _ in range(columns)]
    coder = RangeDecoder(reader.rest(), what)
    rows = RowModel(coder, columns).rows(n, what)
    coder.finish()
    for row in rows:
        for j, centre in enumerate(centres):
            row[j] += centre
            check(in_int32(row[j]), f"{what}: value outside of int32")
    return rows


class RowModel:
    """The decisions of mode 1 of 5.2."""

    def __init__(self, coder: RangeDecoder, columns: int) -> None:
        self.coder = coder
        self.columns = columns
        self.runs = SoloNumbers(coder, 250)
        self.plain: dict[tuple, State] = defaultdict(lambda: State(1000))
        self.other: dict[tuple, State] = defaultdict(lambda: State(250))
        self.weights: dict[tuple[int, int], list[int]] = defaultdict(lambda: 3 * [65536 // 3])

    def rows(self, n: int, what: str) -> Rows:
        """n rows, their columns' centres not yet added."""
        rows: Rows = []
        zeros = self.columns * [0]
        last, before_last = zeros, zeros  # the two rows above, clamped
        while len(rows) < n:
            run = self.runs.size() - 1
            check(run <= n - len(rows), f"{what}: run past the end")
            if run:
                last, before_last = zeros, (zeros if run > 1 else last)
            rows += [self.columns * [0] for _ in range(run)]
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


def decode_run_lengths(data: bytes, n: int, channels: int, what: str) -> Rows:
    """A plain run-length chunk (part 8)."""
    check(n <= 2**27 and channels <= 256, f"{what}: too many rows or channels")
    reader = ByteReader(data, what)
    mode = reader.number("B")
    check(mode in (0, 1), f"{what}: mode {mode}")
    if mode == 0:
        return _plain_rows(reader.rest(), n, channels, what)
    check(n > 0, f"{what}: mode 1 of no rows")
    means = [reader.varint() for _ in range(channels)]
    coder = RangeDecoder(reader.rest(), what)
    rows = [list(means) for _ in range(n)]
    at = 0
    while at < channels:
        width = 3 if channels - at >= 3 else 1
        PlainGroup(coder, width, what).add_to(rows, at)
        at += width
    coder.finish()
    for row in rows:
        check(all(map(in_int32, row)), f"{what}: value outside of int32")
    return rows


class PlainGroup:
    """One group of three channels, or of one, of part 8, with its 31 probabilities."""

    def __init__(self, coder: RangeDecoder, width: int, what: str) -> None:
        self.coder = coder
        self.width = width
        self.what = what
        self.run_p = 5 * [32768]
        self.a0 = 7 * [32768]
        self.a1 = 7 * [32768]
        self.prefix = [3 * [32768], 3 * [32768]]
        self.suffix = [3 * [32768], 3 * [32768]]

    def add_to(self, rows: Rows, at: int) -> None:
        """Decode the group and add its values to the means in columns at, at + 1 ..."""
        i = 0
        while i < len(rows):
            i += self.run(len(rows) - i)
            if i < len(rows):
                for c, v in enumerate(self.row()):
                    rows[i][at + c] += v
                i += 1

    def bit(self, probabilities: list[int], which: int) -> int:
        """A decision by one of the group's probabilities, which learns from it."""
        p = probabilities[which]
        bit = self.coder.decode(p)
        probabilities[which] = p + (65536 - p >> 5) if bit else p - (p >> 5)
        return bit

    def run(self, most: int) -> int:
        """A run of zero rows."""
        length = self.run_length(most)
        check(length <= most, f"{self.what}: run past the end")
        return length

    def run_length(self, most: int) -> int:
        """The number L of zero rows."""
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
            check(x <= most, f"{self.what}: run past the end")
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
        """A row that is not all zero."""
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
