"""The plain run-length coder of attribute rows, for reading; same bytes as C (FORMAT.md)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.reference.codec.coding import Coder, RangeDecoder, RangeEncoder
from clgs.reference.codec.runlength import CORRUPT
from clgs.reference.codec.varint import read_varint, varint

GROUP, RATE = 3, 5
UNARY_RUN, PAIRED_RUN, MAX_ORDER = 3, 11, 32
Context = tuple[str | int, ...]


class Plain:
    """A coder of decisions, each with the probability of its name, in 1/65536."""

    def __init__(self, coder: Coder) -> None:
        self.coder = coder
        self.p: dict[Context, int] = {}

    def bit(self, context: Context, bit: bool) -> int:
        """Code one decision; its probability moves by 1/32 of the distance."""
        p = self.p.get(context, 32768)
        coded = self.coder.code(int(bit), p)
        self.p[context] = p + ((65536 - p) >> RATE) if coded else p - (p >> RATE)
        return coded

    def raw(self, bit: int) -> int:
        """Code one bit at even odds."""
        return self.coder.code(bit, 32768)

    def golomb(self, order: int, value: int, names: Context, last: int, raw: bool = False) -> int:
        """Exp-Golomb code; decisions from number ``last`` on share a probability."""
        first, base, low = order, 0, 0
        while order < MAX_ORDER:
            at = min(order - first, last)
            if not self.bit(("prefix", *names, at), value - base >= 1 << order):
                break
            base += 1 << order
            order += 1
        for place in range(order - 1, -1, -1):
            bit = (value - base) >> place & 1
            context = ("suffix", *names, min(place, last))
            low = low << 1 | (self.raw(bit) if raw else self.bit(context, bool(bit)))
        return base + low

    def run(self, run: int) -> int:
        """Code the length of a run."""
        for known in range(UNARY_RUN):
            if not self.bit(("run", known), run > known):
                return known
        for known in range(UNARY_RUN, PAIRED_RUN, 2):
            if not self.bit(("run", UNARY_RUN), run > known + 1):
                return known + self.raw((run - known) & 1)
        return PAIRED_RUN + self.golomb(2, run - PAIRED_RUN, ("run",), 0, raw=True)

    def magnitude(self, size: int, zero: int, one: int, other: int) -> int:
        """Code an absolute value in the contexts ``zero`` and ``one`` of its first decisions."""
        if not self.bit(("zero", zero), size > 0):
            return 0
        if not self.bit(("one", one), size > 1):
            return 1
        return 2 + self.golomb(1, size - 2, ("size", other), 2)

    def row(self, row: list[int]) -> list[int]:
        """Code a row of one or three differences that are not all 0."""
        size = [abs(value) for value in row]
        zero, one, known = 0, 0, 1
        if len(row) == GROUP:
            size[1] = self.magnitude(size[1], 0, 0, 1)
            size[2] = self.magnitude(size[2], 1 + (size[1] == 0), 1 + (size[1] <= 1), 1)
            zero = 3 + 2 * (size[1] == 0) + (size[2] == 0)
            one = 3 + 2 * (size[1] <= 1) + (size[2] <= 1)
            known = int(size[1] == size[2] == 0)
        size[0] = known + self.magnitude(size[0] - known, zero, one, 0)
        signs = [x > 0 and self.raw(int(value < 0)) for x, value in zip(size, row, strict=True)]
        return [-x if negative else x for x, negative in zip(size, signs, strict=True)]


def encode(value: npt.NDArray[np.int32]) -> bytes:
    """The plain stream of ``value`` (rows, channels) int32."""
    rows = [[int(x) for x in row] for row in value]
    raw = b"\0" + np.asarray(value, "<i4").tobytes()
    if not rows:
        return raw
    means = [(2 * sum(column) + len(rows)) // (2 * len(rows)) for column in zip(*rows, strict=True)]
    coder = RangeEncoder()
    for j, group in groups(len(means)):
        code_group(coder, means[j : j + group], len(rows), [row[j : j + group] for row in rows])
    coded = b"\1" + b"".join(map(varint, means)) + coder.finish()
    return coded if len(coded) <= len(raw) else raw


def decode(data: bytes, rows: int, channels: int) -> npt.NDArray[np.int32]:
    """The matrix (rows, channels) int32 of a stream.

    Raises:
        ValueError: the stream is damaged.
    """
    if data[0] == 0:
        return np.frombuffer(data, "<i4", rows * channels, offset=1).reshape(rows, channels)
    at, means = 1, []
    for _ in range(channels):
        mean, at = read_varint(data, at)
        means.append(mean)
    coder = RangeDecoder(data[at:])
    value = np.empty((rows, channels), np.int32)
    for j, group in groups(channels):
        value[:, j : j + group] = code_group(coder, means[j : j + group], rows, None)
    coder.finish()
    return value


def groups(channels: int) -> list[tuple[int, int]]:
    """First channel and number of channels of what is coded together."""
    whole = channels - channels % GROUP
    return [(j, GROUP) for j in range(0, whole, GROUP)] + [(j, 1) for j in range(whole, channels)]


def code_group(
    coder: Coder, means: list[int], count: int, rows: list[list[int]] | None
) -> list[list[int]]:
    """Code ``count`` rows as runs of rows equal to ``means``, each followed by another row."""
    plain = Plain(coder)
    done: list[list[int]] = []
    while len(done) < count:
        run = 0
        while rows and len(done) + run < count and rows[len(done) + run] == means:
            run += 1
        run = plain.run(run)
        if run > count - len(done):
            raise ValueError(CORRUPT)
        done += [list(means)] * run
        if len(done) < count:
            row = rows[len(done)] if rows else means
            differences = plain.row([x - mean for x, mean in zip(row, means, strict=True)])
            done.append([x + mean for x, mean in zip(differences, means, strict=True)])
        if not all(-(2**31) <= x < 2**31 for x in done[-1]):
            raise ValueError(CORRUPT)
    return done
