"""Part 7, 7.1 to 7.4: the shared header, residuals, classes, and channels with tables."""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np

from tests.codec.from_document.common import (
    INT32_MAX,
    INT32_MIN,
    ByteReader,
    check,
    clamp,
    unzigzag,
    wrap,
    zigzag,
)
from tests.codec.from_document.entropy import RangeDecoder, SoloNumbers
from tests.codec.from_document.mixed import MixedChannel
from tests.codec.from_document.prediction import Prediction, rows_before
from tests.codec.from_document.rows import decode_run_lengths

THRESHOLDS = [
    4, 5, 6, 7, 8, 10, 11, 13, 16, 19, 23, 27, 32, 38, 45, 54, 64, 76, 91, 108, 128, 152, 181,
    215, 256, 304, 362, 431, 512, 609, 724,
]  # fmt: skip
SYMBOLS = 228
LANES = 8


@dataclass
class Table:
    """Frequencies of the symbols of a class."""

    frequencies: list[int]

    def __post_init__(self) -> None:
        self.starts = [0, *accumulate(self.frequencies)]
        self.slots = [s for s, f in enumerate(self.frequencies) for _ in range(f)]


@dataclass
class Channel:
    """What the header says of a channel."""

    centre: int
    taps: list[tuple[int, int, int]] = field(default_factory=list)  # channel, row, factor
    gain: int = 0
    weights: tuple[int, int, int] = (0, 0, 0)
    span: int = 0
    mixed: bool = False
    classes: list[int] = field(default_factory=lambda: 64 * [0])
    tables: list[Table] = field(default_factory=list)


class HeaderReader:
    """The header of mode 1 (7.1)."""

    def __init__(self, data: bytes, what: str) -> None:
        self.coder = RangeDecoder(data, what)
        self.what = what
        self.kinds: dict[str, SoloNumbers] = {}

    def read(self, channels: int) -> list[Channel]:
        """All channels."""
        read = [self.channel(j) for j in range(channels)]
        self.coder.finish()
        return read

    def kind(self, name: str) -> SoloNumbers:
        """The states and weights of a kind of number."""
        if name not in self.kinds:
            self.kinds[name] = SoloNumbers(self.coder, 250)
        return self.kinds[name]

    def number(self, name: str, low: int, high: int) -> int:
        """A number of a kind in [low, high]."""
        value = self.kind(name).value()
        check(low <= value <= high, f"{self.what}: {name} is {value}, out of range")
        return value

    def channel(self, j: int) -> Channel:
        """Channel j."""
        channel = Channel(self.number("centre", INT32_MIN, INT32_MAX))
        if self.number("rich", 0, 1):
            for _ in range(self.number("taps", 0, 16)):
                back = self.number("tap channel", 0, j)
                row = self.number("tap row", -4, 3 if back else -1)
                channel.taps.append((j - back, row, self.number("tap factor", -2047, 2047)))
            channel.gain = self.number("gain", 0, 65535)
            w0, w1, w2 = (self.number(f"weight {k}", 0, 8191) for k in range(3))
            channel.weights = (w0, w1, w2)
            channel.span = self.number("span", 0, min(j, 2))
            channel.mixed = self.number("coder", 0, 1) == 1
            if not channel.mixed:
                self.read_classes(channel)
        if not channel.mixed:
            channel.tables = [self.table() for _ in range(max(channel.classes) + 1)]
        return channel

    def read_classes(self, channel: Channel) -> None:
        """The class of each of the 64 cells."""
        last = 0
        for cell in range(1, 64):
            never = (cell != 32 and not any(channel.weights)) or (cell >= 32 and channel.span == 0)
            if never:
                continue
            last += self.kind("class").decide(0)
            check(last < 16, f"{self.what}: more than 16 classes")
            channel.classes[cell] = last

    def table(self) -> Table:
        """A table of frequencies."""
        f: list[int] = []
        total = 0
        for s in range(SYMBOLS):
            if total == 4096:
                break
            guess = min(_guess(f, s), 4096 - total)
            kind = self.kind(f"frequency {guess.bit_length()}")
            f.append(guess + kind.value())
            total += f[s]
            check(f[s] >= 0 and total <= 4096, f"{self.what}: frequency out of range")
        check(total == 4096, f"{self.what}: sum of a table is {total}")
        return Table(f + (SYMBOLS - len(f)) * [0])


def _guess(f: list[int], s: int) -> int:
    """What frequency s of a table is expected to be."""
    if s == 0:
        return 0
    if s == 1 or s % 2 == 0:
        return f[s - 1]
    last = f[s - 1] + f[s - 2]
    before = f[s - 3] + f[max(s - 4, 0)]
    return last * last // before // 2 if before > last else last // 2


class Words:
    """The states and words of a chunk (7.4)."""

    def __init__(self, data: bytes, n: int, what: str) -> None:
        self.what = what
        self.lanes = LANES if n >= 2048 else 1
        size = len(data)
        if self.lanes == LANES:
            check(size >= 32, f"{what}: states cut")
            self.states = list(struct.unpack("<8I", data[:32]))
            check(min(self.states) >= 65536, f"{what}: state below 65536")
            at = 32
        else:
            check(size > 0, f"{what}: no state")
            at = size if size <= 4 else 4 - size % 2
            check(at == 1 or data[at - 1] != 0, f"{what}: state with a needless byte")
            self.states = [int.from_bytes(data[:at], "little")]
        check((size - at) % 2 == 0, f"{what}: half a word")
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

    def symbol(self, lane: int, table: Table) -> int:
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
                check(self.lanes == 1, f"{self.what}: no word left")
        self.states[lane] = x
        return s

    def finish(self) -> None:
        """Check the last states, and that all words are used."""
        check(self.used == len(self.words), f"{self.what}: words left over")
        last = 65536 if self.lanes == LANES else 1
        check(all(x == last for x in self.states), f"{self.what}: final state")


class Literals:
    """Literal bits, lowest first (7.2)."""

    def __init__(self, data: bytes, what: str) -> None:
        self.bits = int.from_bytes(data, "little")
        self.left = 8 * len(data)
        self.what = what

    def take(self, count: int) -> int:
        """The next `count` bits."""
        check(count <= self.left, f"{self.what}: literals cut")
        self.left -= count
        value = self.bits & (1 << count) - 1
        self.bits >>= count
        return value

    def finish(self) -> None:
        """No byte may be left over, no filling bit may be 1."""
        check(self.left < 8 and self.bits == 0, f"{self.what}: literals left over")


def symbol_of(residual: int) -> int:
    """The symbol of a residual."""
    z = zigzag(residual)
    if z < 128:
        return z
    t = z.bit_length() - 1
    return 128 + 4 * (t - 7) + (z >> t - 2 & 3)


class Chunk:
    """A chunk of mode 1: all its channels, one after another."""

    def __init__(
        self, data: bytes, n: int, channels: list[Channel], near: list[list[int]], what: str
    ) -> None:
        self.n = n
        self.channels = channels
        self.near = near
        reader = ByteReader(data, what)
        tables = [table for channel in channels for table in channel.tables]
        literal = any(f for table in tables for f in table.frequencies[128:])
        self.literals = Literals(reader.take(reader.varint()) if literal else b"", what)
        mixed = any(channel.mixed for channel in channels)
        self.words: Words | None = None
        if tables:
            size = reader.varint() if mixed else reader.left
            self.words = Words(reader.take(size), n, what)
        self.coder = RangeDecoder(reader.rest(), what) if mixed else None
        reader.finish()
        self.activity = [0] * (n + 2)  # at i + 1: that of row i
        self.symbols: list[list[int]] = []
        self.values: list[list[int]] = []  # v of 7.2
        self.clamped: list[list[int]] = []  # v'

    def decode(self) -> np.ndarray:
        """n rows of int32."""
        decoded = np.empty((self.n, len(self.channels)), np.int32)
        for j, channel in enumerate(self.channels):
            if channel.mixed:
                self.mixed_channel(channel)
            else:
                self.table_channel(channel)
            decoded[:, j] = [wrap(v + channel.centre) for v in self.values[j]]
            if channel.gain:
                for i, s in enumerate(self.symbols[j]):
                    self.activity[i + 1] += magnitude(s, channel.gain)
        if self.words is not None:
            self.words.finish()
        if self.coder is not None:
            self.coder.finish()
        self.literals.finish()
        return decoded

    def predictor(self, channel: Channel) -> Callable[[int], Prediction]:
        """The prediction at row i, v' of earlier rows being known."""
        n, near = self.n, self.near
        taps = [(self.clamped[k], row, factor) for k, row, factor in channel.taps]

        def prediction(i: int) -> Prediction:
            total = 512
            for values, row, factor in taps:
                if row == -4:
                    total += factor * sum(values[e] for e in near[i])
                elif 0 <= i + row < n:
                    total += 4 * factor * values[i + row]
            return Prediction(wrap(total))

        return prediction

    def cell_finder(self, channel: Channel) -> Callable[[int, int], int]:
        """The cell (7.3) at row i, own symbols before row `first` not being looked at."""
        w0, w1, w2 = channel.weights
        j = len(self.symbols) - 1
        own = self.symbols[j]
        others = self.symbols[j - channel.span : j]
        activity, gain = self.activity, channel.gain

        def cell(i: int, first: int) -> int:
            total = w1 * activity[i + 1] + w2 * (activity[i] + activity[i + 2])
            if i > first:
                total += 2 * w0 * magnitude(own[i - 1], gain)
            if i > first + 1:
                total += w0 * magnitude(own[i - 2], gain)
            return bisect_right(THRESHOLDS, total >> 10) + 32 * any(s[i] for s in others)

        return cell

    def begin_channel(self) -> None:
        """Room for symbols and values of the next channel."""
        self.symbols.append(self.n * [0])
        self.values.append(self.n * [0])
        self.clamped.append(self.n * [0])

    def set_value(self, i: int, value: int) -> None:
        """v of the present channel at row i."""
        self.values[-1][i] = value
        self.clamped[-1][i] = clamp(value, -32767, 32767)

    def table_channel(self, channel: Channel) -> None:
        """A channel with tables."""
        assert self.words is not None
        self.begin_channel()
        symbols = self.symbols[-1]
        cell = self.cell_finder(channel)
        by_cell = [channel.tables[c] for c in channel.classes]
        for lane, first, i in self.words.order():
            symbols[i] = self.words.symbol(lane, by_cell[cell(i, first)])
        prediction = self.predictor(channel)
        for i, s in enumerate(symbols):
            z = s
            if s >= 128:
                count = 5 + (s - 128) // 4
                z = (4 + (s - 128) % 4 << count) + self.literals.take(count)
            self.set_value(i, prediction(i).value(unzigzag(z)))

    def mixed_channel(self, channel: Channel) -> None:
        """A mixed channel."""
        assert self.coder is not None
        self.begin_channel()
        model = MixedChannel(self.coder, self.symbols, self.clamped[-1], self.n)
        prediction = self.predictor(channel)
        cell = self.cell_finder(channel)
        for i in range(self.n):
            predicted = prediction(i)
            expected = predicted.rounded if channel.taps else model.expected(i)
            residual = wrap(model.residual(i, cell(i, 0), expected, predicted.eighths))
            self.symbols[-1][i] = symbol_of(residual)
            self.set_value(i, wrap(residual + predicted.rounded))
            model.learn(i)


def magnitude(symbol: int, gain: int) -> int:
    """Magnitude of a symbol (7.3)."""
    return min((symbol + 1) // 2 * gain >> 4, 255)


class Attributes:
    """A decoder of the chunks that share a header."""

    def __init__(self, header: bytes, channels: int, what: str) -> None:
        check(len(header) > 0, f"{what}: no header")
        self.mode = header[0]
        self.columns = channels
        self.what = what
        check(self.mode == 1 or (self.mode in (0, 2) and len(header) == 1), f"{what}: header mode")
        self.channels: list[Channel] = []
        if self.mode == 1:
            self.channels = HeaderReader(header[1:], f"{what} header").read(channels)

    @property
    def looks_near(self) -> bool:
        """Whether a term looks at near rows."""
        return any(row == -4 for channel in self.channels for _, row, _ in channel.taps)

    def decode(
        self, data: bytes, n: int, number: int, near: list[list[int]] | None = None
    ) -> np.ndarray:
        """Chunk `number`, of n rows, as int32; `near`: by positions, if there are any."""
        what = f"{self.what} chunk {number}"
        check(n * self.columns <= 2**28, f"{what}: too many values")
        if self.mode == 0:
            check(len(data) == 4 * n * self.columns, f"{what}: wrong length")
            return np.frombuffer(data, "<i4").reshape(n, self.columns)
        if self.mode == 2:
            return np.array(decode_run_lengths(data, n, self.columns, what), np.int32)
        if near is None:
            near = rows_before(n)
        return Chunk(data, n, self.channels, near, what).decode()
