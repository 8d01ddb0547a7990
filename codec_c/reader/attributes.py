"""Attributes of the rows of a chunk: part 7 of FORMAT.md."""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np

from .coding import (
    ByteReader,
    NumberDecoder,
    RangeDecoder,
    check,
    clamp,
    unzigzag,
    wrap,
    zigzag,
)
from .mixed import MixedModel
from .rows import decode_paper_rows

THRESHOLDS = [
    4, 5, 6, 7, 8, 10, 11, 13, 16, 19, 23, 27, 32, 38, 45, 54, 64, 76, 91, 108, 128, 152, 181,
    215, 256, 304, 362, 431, 512, 609, 724,
]  # fmt: skip
SYMBOLS = 228
NEAR = -4  # the row of a tap that looks at the near rows


class FrequencyTable:
    """The frequencies of the symbols of a class."""

    def __init__(self, frequencies: list[int]) -> None:
        self.frequencies = frequencies
        self.starts = [0, *accumulate(frequencies)]
        self.slots = [s for s, f in enumerate(frequencies) for _ in range(f)]


@dataclass
class Channel:
    """What the header says of a channel; a tap is (channel, row, factor)."""

    centre: int
    taps: list[tuple[int, int, int]] = field(default_factory=list)
    gain: int = 0
    weights: tuple[int, ...] = (0, 0, 0)
    span: int = 0
    mixed: bool = False
    known: bool = False
    sided: bool = False
    classes: list[int] = field(default_factory=lambda: 64 * [0])
    tables: list[FrequencyTable] = field(default_factory=list)


class HeaderDecoder:
    """The header of mode 1 (7.1)."""

    def __init__(self, data: bytes) -> None:
        self.coder = RangeDecoder(data)
        self.kinds: dict[str, NumberDecoder] = {}

    def decode(self, channels: int) -> list[Channel]:
        """All channels."""
        found = [self.channel(j) for j in range(channels)]
        self.coder.finish()
        return found

    def kind(self, name: str) -> NumberDecoder:
        """The states and weights of a kind of number."""
        return self.kinds.setdefault(name, NumberDecoder(self.coder, 250))

    def number(self, name: str, low: int, high: int) -> int:
        """A number of a kind in [low, high]."""
        value = self.kind(name).value()
        check(low <= value <= high, f"{name} is {value}, out of range")
        return value

    def channel(self, j: int) -> Channel:
        """Channel j."""
        channel = Channel(self.number("centre", -(2**31), 2**31 - 1))
        if self.number("rich", 0, 1):
            for _ in range(self.number("taps", 0, 16)):
                back = self.number("tap channel", 0, j)
                row = self.number("tap row", NEAR, 3 if back else -1)
                channel.taps.append((j - back, row, self.number("tap factor", -2047, 2047)))
            channel.gain = self.number("gain", 0, 65535)
            channel.weights = tuple(self.number(f"weight {k}", 0, 8191) for k in range(3))
            channel.span = self.number("span", 0, min(j, 2))
            coder = self.number("coder", 0, 3)
            channel.mixed, channel.known, channel.sided = coder == 1, coder == 2, coder == 3
            check(not (channel.known and channel.taps), "a known channel with taps")
            if channel.sided:
                others = all(k < j for k, _, _ in channel.taps) and not any(channel.weights)
                check(bool(channel.taps) and others, "a sided channel looks at itself")
            if channel.sided or coder == 0:
                self.read_classes(channel)
        if not (channel.mixed or channel.known):
            channel.tables = [self.table() for _ in range(max(channel.classes) + 1)]
        return channel

    def read_classes(self, channel: Channel) -> None:
        """The class of each of the 64 cells."""
        last = 0
        for cell in range(1, 64):
            levels = channel.sided or any(channel.weights)
            never = (cell != 32 and not levels) or (cell >= 32 and channel.span == 0)
            if not never:
                last += self.kind("class").decide(0)
                check(last < 16, "more than 16 classes")
                channel.classes[cell] = last

    def table(self) -> FrequencyTable:
        """The frequencies of a class."""
        f: list[int] = []
        left = 4096
        while left > 0 and len(f) < SYMBOLS:
            guess = min(_expected_frequency(f), left)
            f.append(guess + self.kind(f"frequency {guess.bit_length()}").value())
            left -= f[-1]
            check(f[-1] >= 0 and left >= 0, "a frequency is out of range")
        check(left == 0, f"the sum of a table is {4096 - left}")
        return FrequencyTable(f + (SYMBOLS - len(f)) * [0])


def _expected_frequency(f: list[int]) -> int:
    """What the frequency after those of `f` is expected to be."""
    s = len(f)
    if s == 0:
        return 0
    if s == 1 or s % 2 == 0:
        return f[s - 1]
    last = f[s - 1] + f[s - 2]
    before = f[s - 3] + f[max(s - 4, 0)]
    return last * last // before // 2 if before > last else last // 2


class SymbolDecoder:
    """The states and words of a chunk (7.4)."""

    def __init__(self, data: bytes, n: int) -> None:
        self.lanes = 8 if n >= 2048 else 1
        size = len(data)
        if self.lanes == 8:
            check(size >= 32, "the states are cut")
            at = 32
            self.states = list(struct.unpack("<8I", data[:at]))
            check(min(self.states) >= 65536, "a state below 65536")
        else:
            check(size > 0, "there is no state")
            at = size if size <= 4 else 4 - size % 2
            check(at == 1 or data[at - 1] != 0, "a state with a needless byte")
            self.states = [int.from_bytes(data[:at], "little")]
        check((size - at) % 2 == 0, "half a word")
        self.words = struct.unpack(f"<{(size - at) // 2}H", data[at:])
        self.used = 0
        self.first_row = [lane * (n // self.lanes) + min(lane, n % self.lanes)
                          for lane in range(self.lanes + 1)]  # fmt: skip

    def order(self) -> Iterator[tuple[int, int, int]]:
        """Lane, its first row, and row, in the order in which symbols are decoded."""
        for step in range(self.first_row[1]):
            for lane in range(self.lanes):
                first = self.first_row[lane]
                if first + step < self.first_row[lane + 1]:
                    yield lane, first, first + step

    def symbol(self, lane: int, table: FrequencyTable) -> int:
        """The next symbol of a lane."""
        x = self.states[lane]
        slot = x & 4095
        s = table.slots[slot]
        x = table.frequencies[s] * (x >> 12) + slot - table.starts[s]
        if x < 65536:
            if self.used < len(self.words):
                x = x << 16 | self.words[self.used]
                self.used += 1
            else:
                check(self.lanes == 1, "no word is left")
        self.states[lane] = x
        return s

    def finish(self) -> None:
        """Check the last states, and that all words were used."""
        check(self.used == len(self.words), "words are left over")
        last = 65536 if self.lanes == 8 else 1
        check(all(x == last for x in self.states), "the last state is wrong")


class LiteralBits:
    """Literal bits, lowest first (7.2)."""

    def __init__(self, data: bytes) -> None:
        self.bits = int.from_bytes(data, "little")
        self.left = 8 * len(data)

    def take(self, count: int) -> int:
        """The next `count` bits."""
        check(count <= self.left, "the literals are cut")
        self.left, value = self.left - count, self.bits & (1 << count) - 1
        self.bits >>= count
        return value

    def finish(self) -> None:
        """No byte may be left over, and no bit that fills the last byte may be 1."""
        check(self.left < 8 and self.bits == 0, "literals are left over")


def symbol_of(residual: int) -> int:
    """The symbol of a residual (7.2)."""
    z = zigzag(residual)
    if z < 128:
        return z
    t = z.bit_length() - 1
    return 128 + 4 * (t - 7) + (z >> t - 2 & 3)


def magnitude(symbol: int, gain: int) -> int:
    """Magnitude of a symbol (7.3)."""
    return min((symbol + 1) // 2 * gain >> 4, 255)


class TableChunk:
    """A chunk of mode 1: all its channels, one after another; `known` are rows of known values."""

    def __init__(
        self,
        data: bytes,
        n: int,
        channels: list[Channel],
        near: list[list[int]],
        known: np.ndarray | None = None,
    ) -> None:
        self.n = n
        self.channels = channels
        self.near = near
        self.known = known
        reader = ByteReader(data)
        tables = [table for channel in channels for table in channel.tables]
        literal = any(f for table in tables for f in table.frequencies[128:])
        self.literals = LiteralBits(reader.take(reader.varint()) if literal else b"")
        mixed = any(channel.mixed for channel in channels)
        self.words: SymbolDecoder | None = None
        if tables:
            self.words = SymbolDecoder(reader.take(reader.varint() if mixed else reader.left), n)
        self.coder = RangeDecoder(reader.rest()) if mixed else None
        reader.finish()
        self.activity = [0] * (n + 2)  # at i + 1: that of row i
        self.symbols: list[list[int]] = []
        self.values: list[list[int]] = []  # v of 7.2
        self.clamped: list[list[int]] = []  # v' of 7.2

    def decode(self) -> np.ndarray:
        """n rows of int32."""
        decoded = np.empty((self.n, len(self.channels)), np.int32)
        for j, channel in enumerate(self.channels):
            for columns in (self.symbols, self.values, self.clamped):
                columns.append(self.n * [0])
            if channel.known:
                self.take_known(channel)
            elif channel.mixed:
                self.decode_mixed(channel)
            else:
                self.decode_tables(channel)
            decoded[:, j] = [wrap(v + channel.centre) for v in self.values[j]]
            if channel.gain:
                for i, s in enumerate(self.symbols[j]):
                    self.activity[i + 1] += magnitude(s, channel.gain)
        for stream in (self.words, self.coder, self.literals):
            if stream is not None:
                stream.finish()
        return decoded

    def predict(self, channel: Channel, i: int) -> int:
        """The sum of the terms at row i and one half (7.2); v' of earlier rows must be known."""
        return wrap(self.terms(channel, i) + 512)

    def terms(self, channel: Channel, i: int) -> int:
        """The sum of the terms at row i."""
        total = 0
        for k, row, factor in channel.taps:
            if row == NEAR:
                total += factor * sum(self.clamped[k][e] for e in self.near[i])
            elif 0 <= i + row < self.n:
                total += 4 * factor * self.clamped[k][i + row]
        return wrap(total)

    def cell_finder(self, channel: Channel) -> Callable[[int, int], int]:
        """The cell (7.3) of row i, with the own symbols from row `first` on."""
        w0, w1, w2 = channel.weights
        own, activity, gain = self.symbols[-1], self.activity, channel.gain
        others = self.symbols[-1 - channel.span : -1]

        def cell(i: int, first: int) -> int:
            total = w1 * activity[i + 1] + w2 * (activity[i] + activity[i + 2])
            if i > first:
                total += 2 * w0 * magnitude(own[i - 1], gain)
            if i > first + 1:
                total += w0 * magnitude(own[i - 2], gain)
            sides = min(abs(self.terms(channel, i)) >> 8, 31)
            level = sides if channel.sided else bisect_right(THRESHOLDS, total >> 10)
            return level + 32 * any(s[i] for s in others)

        return cell

    def set_value(self, i: int, value: int) -> None:
        """Set v of the last channel at row i."""
        self.values[-1][i] = value
        self.clamped[-1][i] = clamp(value, -32767, 32767)

    def take_known(self, channel: Channel) -> None:
        """A known channel (7.1): what other channels see of it."""
        assert self.known is not None
        for i, value in enumerate(self.known[:, len(self.values) - 1].tolist()):
            self.set_value(i, wrap(value - channel.centre))
            self.symbols[-1][i] = symbol_of(self.values[-1][i])

    def decode_tables(self, channel: Channel) -> None:
        """A channel with tables (7.4)."""
        assert self.words is not None
        symbols, cell = self.symbols[-1], self.cell_finder(channel)
        table_of_cell = [channel.tables[c] for c in channel.classes]
        for lane, first, i in self.words.order():
            symbols[i] = self.words.symbol(lane, table_of_cell[cell(i, first)])
        for i, s in enumerate(symbols):
            z = s
            if s >= 128:
                count = 5 + (s - 128) // 4
                z = (4 + (s - 128) % 4 << count) + self.literals.take(count)
            total, residual = self.predict(channel, i), unzigzag(z)
            minus = self.terms(channel, i) < 0 if channel.sided else total % 1024 < 512
            prediction = 0 if channel.sided else total >> 10
            self.set_value(i, wrap(prediction - residual if minus else prediction + residual))

    def decode_mixed(self, channel: Channel) -> None:
        """A mixed channel (7.5)."""
        assert self.coder is not None
        model = MixedModel(self.coder, self.symbols, self.n)
        clamped, cell = self.clamped[-1], self.cell_finder(channel)
        for i in range(self.n):
            total = self.predict(channel, i)
            before = [clamped[i - back] if i >= back else 0 for back in (1, 2)]
            expected = total >> 10 if channel.taps else sum(before) >> 1
            residual = wrap(model.residual(i, cell(i, 0), expected, total % 1024 // 128))
            self.symbols[-1][i] = symbol_of(residual)
            self.set_value(i, wrap(residual + (total >> 10)))
            model.learn(clamped[i])


class Attributes:
    """A decoder of the chunks that share a header; `known` says which channels must be known."""

    def __init__(self, header: bytes, columns: int, known: list[bool] | None = None) -> None:
        check(len(header) > 0, "no header of attributes")
        self.mode, self.columns = header[0], columns
        alone = self.mode in (0, 2) and len(header) == 1
        check(self.mode == 1 or alone, f"mode {self.mode}")
        self.channels = HeaderDecoder(header[1:]).decode(columns) if self.mode == 1 else []
        wanted = [False] * len(self.channels) if known is None else known
        check([c.known for c in self.channels] == wanted, "other channels are known")
        check(any(wanted) or not any(c.sided for c in self.channels), "a sided channel elsewhere")

    @property
    def looks_near(self) -> bool:
        """Whether a term looks at near rows."""
        return any(row == NEAR for channel in self.channels for _, row, _ in channel.taps)

    def decode(
        self,
        data: bytes,
        n: int,
        near: list[list[int]] | None = None,
        known: np.ndarray | None = None,
    ) -> np.ndarray:
        """A chunk of n rows as int32; `near` is given if the rows have positions.

        `known`: n rows with the values of known channels, if there are any.
        """
        check(n * self.columns <= 2**28, "too many values")
        if self.mode == 0:
            check(len(data) == 4 * n * self.columns, "values of a wrong length")
            return np.frombuffer(data, "<i4").reshape(n, self.columns)
        if self.mode == 2:
            return np.array(decode_paper_rows(data, n, self.columns), np.int32)
        if near is None:  # the rows before
            near = [list(range(i - 1, max(i - 5, -1), -1)) for i in range(n)]
        return TableChunk(data, n, self.channels, near, known).decode()


def near_rows(positions: list[list[int]]) -> list[list[int]]:
    """The near rows (7.2) of every row of a chunk."""
    points = np.array(positions, np.int64).reshape(-1, 3)
    near: list[list[int]] = []
    for i in range(len(points)):
        distance = ((points[:i] - points[i]) ** 2).sum(axis=1)[::-1]
        near.append([i - 1 - int(k) for k in np.argsort(distance, kind="stable")[:4]])
    return near
