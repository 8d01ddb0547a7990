"""Chunks of attribute rows and the header they share, for reading (FORMAT.md on attributes).

Plain integers, one symbol at a time; the same bytes as C.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgs.reference.codec import rans
from clgs.reference.codec.coding import Coder, RangeDecoder, RangeEncoder
from clgs.reference.codec.mixed import Column, code_column
from clgs.reference.codec.prediction import (
    NEAR,
    residual_of,
    rows_before,
    sum_of_terms,
    value_of,
    wrap,
    wrapped_difference,
)
from clgs.reference.codec.runlength import CORRUPT, Symbol
from clgs.reference.codec.varint import read_varint, varint

ALPHABET, DIRECT, CELLS, CLASSES, TAPS, REACH = 228, 128, 64, 16, 16, 3
MAX_FACTOR, MAX_GAIN, MAX_WEIGHT = 2047, 65535, 8191
THRESHOLDS = [4, 5, 6, 7, 8, 10, 11, 13, 16, 19, 23, 27, 32, 38, 45, 54, 64, 76, 91, 108, 128]
THRESHOLDS += [152, 181, 215, 256, 304, 362, 431, 512, 609, 724]


@dataclass
class Channel:
    """What the header says of a channel. A tap is (channel, row or NEAR, factor)."""

    centre: int = 0
    taps: list[tuple[int, int, int]] = field(default_factory=list)
    gain: int = 0
    weight: list[int] = field(default_factory=lambda: [0, 0, 0])
    span: int = 0
    mixed: bool = False
    class_of: list[int] = field(default_factory=lambda: [0] * CELLS)
    frequency: list[list[int]] = field(default_factory=list)

    def plain(self) -> bool:
        """Whether the centre and one table are all."""
        return not (self.taps or self.gain or any(self.weight) or self.span or self.mixed)


def write_header(channels: list[Channel]) -> bytes:
    """The header of the models of all channels."""
    coder = RangeEncoder()
    _code_header(coder, channels)
    return b"\1" + coder.finish()


def read_header(data: bytes, channels: int) -> list[Channel]:
    """The models of ``channels`` channels.

    Raises:
        ValueError: the header is damaged.
    """
    if data[0] != 1:
        raise ValueError(CORRUPT)
    coder = RangeDecoder(data[1:])
    models = [Channel() for _ in range(channels)]
    _code_header(coder, models)
    coder.finish()
    return models


class _Fields:
    """The numbers of the header; each kind has states of its own."""

    def __init__(self, coder: Coder) -> None:
        self.coder = coder
        self.symbols: dict[str, Symbol] = {}

    def number(self, kind: str, value: int, low: int, high: int) -> int:
        value = self.symbols.setdefault(kind, Symbol((250,))).value(self.coder, value)
        if not low <= value <= high:
            raise ValueError(CORRUPT)
        return value

    def decision(self, kind: str, bit: int) -> int:
        return self.symbols.setdefault(kind, Symbol((250,))).bit(self.coder, 0, bit)


def _code_header(coder: Coder, channels: list[Channel]) -> None:
    fields = _Fields(coder)
    for j, channel in enumerate(channels):
        channel.centre = fields.number("centre", channel.centre, -(2**31), 2**31 - 1)
        if fields.number("rich", int(not channel.plain()), 0, 1):
            _code_taps(fields, channel, j)
            channel.gain = fields.number("gain", channel.gain, 0, MAX_GAIN)
            for i in range(3):
                channel.weight[i] = fields.number(f"weight {i}", channel.weight[i], 0, MAX_WEIGHT)
            channel.span = fields.number("span", channel.span, 0, min(j, 2))
            channel.mixed = bool(fields.number("coder", int(channel.mixed), 0, 1))
            if channel.mixed:
                continue
            _code_classes(fields, channel)
        classes = max(channel.class_of) + 1
        tables = channel.frequency or [[0] * ALPHABET for _ in range(classes)]
        channel.frequency = [_code_table(fields, table) for table in tables]


def _code_taps(fields: _Fields, channel: Channel, j: int) -> None:
    count = fields.number("taps", len(channel.taps), 0, TAPS)
    taps = channel.taps or [(0, 0, 0)] * count
    channel.taps = []
    for source, row, factor in taps:
        source = j - fields.number("tap channel", j - source, 0, j)
        row = fields.number("tap row", row, NEAR, -1 if source == j else REACH)
        factor = fields.number("tap factor", factor, -MAX_FACTOR, MAX_FACTOR)
        channel.taps.append((source, row, factor))


def _code_classes(fields: _Fields, channel: Channel) -> None:
    """Does a new class start at this cell? Asked of the cells that can occur."""
    last, coded = 0, [0] * CELLS
    for cell in range(1, CELLS):
        if (any(channel.weight) or cell % 32 == 0) and (channel.span or cell < 32):
            last += fields.decision("class", int(channel.class_of[cell] != last))
            coded[cell] = last
    if last >= CLASSES:
        raise ValueError(CORRUPT)
    channel.class_of = coded


def _code_table(fields: _Fields, table: list[int]) -> list[int]:
    left, coded = 1 << rans.SCALE_BITS, [0] * ALPHABET
    for s in range(ALPHABET):
        if left == 0:
            break
        guess = min(_expected(coded, s), left)
        kind = f"frequency {guess.bit_length()}"
        coded[s] = guess + fields.number(kind, table[s] - guess, -guess, left - guess)
        left -= coded[s]
    if left:
        raise ValueError(CORRUPT)
    return coded


def _expected(frequency: list[int], s: int) -> int:
    """The frequency of the same size with the other sign, or one of a geometric decay."""
    if s == 0:
        return 0
    if s % 2 == 0 or s == 1:
        return frequency[s - 1]
    last = frequency[s - 1] + frequency[s - 2]
    before = frequency[s - 3] + frequency[max(s - 4, 0)]
    return (last * last // before if before > last else last) // 2


def encode(
    channels: list[Channel], rows: npt.NDArray[np.int32], near: list[list[int]] | None = None
) -> bytes:
    """The chunk of ``rows`` (n, channels) int32, n > 0.

    ``near``: the near rows of each by its position; without positions the rows before it.
    """
    near = rows_before(len(rows)) if near is None else near
    columns = [[int(x) for x in column] for column in rows.T]
    values = [
        [wrap(x - c.centre) for x in column] for c, column in zip(channels, columns, strict=True)
    ]
    symbols: list[list[int]] = []
    literals, bits = 0, 0
    order: list[tuple[list[int], int]] = []
    for j, channel in enumerate(channels):
        zigzags = _zigzags(channel, values, near, j)
        symbols.append([_symbol(zigzag) for zigzag in zigzags])
        if channel.mixed:
            continue
        for zigzag, symbol in zip(zigzags, symbols[j], strict=True):
            if symbol >= DIRECT:
                literals |= (zigzag & (1 << _literal_bits(symbol)) - 1) << bits
                bits += _literal_bits(symbol)
        for i in rans.coding_order(len(rows)):
            order.append((_table(channels, symbols, j, i), symbols[j][i]))
    data = b""
    if _any_literals(channels):
        literal_bytes = literals.to_bytes((bits + 7) // 8, "little")
        data += varint(len(literal_bytes)) + literal_bytes
    if order:
        symbols_coded = rans.encode_symbols(order, len(rows))
        mixed = any(channel.mixed for channel in channels)
        data += (varint(len(symbols_coded)) if mixed else b"") + symbols_coded
    return data + _encode_mixed(channels, values, symbols, near)


def _any_literals(channels: list[Channel]) -> bool:
    """Whether a table has a symbol that literal bits follow."""
    return any(any(table[DIRECT:]) for c in channels if not c.mixed for table in c.frequency)


def _zigzags(channel: Channel, values: list[list[int]], near: list[list[int]], j: int) -> list[int]:
    """Zigzag numbers of the residuals of column j."""
    sums = (sum_of_terms(channel.taps, values, near, i) for i in range(len(values[j])))
    residual = wrapped_difference if channel.mixed else residual_of
    residuals = [residual(value, total) for value, total in zip(values[j], sums, strict=True)]
    return [2 * r if r >= 0 else -2 * r - 1 for r in residuals]


def _encode_mixed(
    channels: list[Channel],
    values: list[list[int]],
    symbols: list[list[int]],
    near: list[list[int]],
) -> bytes:
    """Decisions of all mixed channels."""
    if not any(channel.mixed for channel in channels):
        return b""
    coder = RangeEncoder()
    for j, channel in enumerate(channels):
        if channel.mixed:
            code_column(coder, _column(channels, values, symbols, near, j))
    return coder.finish()


def _column(
    channels: list[Channel],
    values: list[list[int]],
    symbols: list[list[int]],
    near: list[list[int]],
    j: int,
) -> Column:
    return Column(
        j,
        values,
        symbols,
        has_taps=bool(channels[j].taps),
        sum_of_terms=lambda i: sum_of_terms(channels[j].taps, values, near, i),
        cell=lambda i: _cell(channels, symbols, j, i, first=0),
        symbol_of=_symbol,
    )


def decode(
    channels: list[Channel], data: bytes, count: int, near: list[list[int]] | None = None
) -> npt.NDArray[np.int32]:
    """The rows (count, channels) int32 of a chunk, count > 0; ``near`` as the encoder had it.

    Raises:
        ValueError: the chunk is damaged.
    """
    near = rows_before(count) if near is None else near
    literals = _Bits(b"")
    if _any_literals(channels):
        part, data = _take(data)
        literals = _Bits(part)
    states, source = rans.first_states(count), list[int]()
    if not all(channel.mixed for channel in channels):
        mixed = any(channel.mixed for channel in channels)
        static, data = _take(data) if mixed else (data, b"")
        states, source = rans.split_words(static, count)
    coder = RangeDecoder(data)
    values: list[list[int]] = []
    symbols: list[list[int]] = []
    for j, channel in enumerate(channels):
        symbols.append([0] * count)
        values.append([0] * count)
        if channel.mixed:
            code_column(coder, _column(channels, values, symbols, near, j))
            continue
        for i in rans.coding_order(count):
            lane, table = rans.lane_of(count, i), _table(channels, symbols, j, i)
            symbols[j][i], states[lane] = rans.decode_symbol(states[lane], table, source)
        for i, symbol in enumerate(symbols[j]):
            zigzag = symbol if symbol < DIRECT else _large(symbol, literals)
            residual = zigzag >> 1 if zigzag % 2 == 0 else ~(zigzag >> 1)
            values[j][i] = value_of(residual, sum_of_terms(channel.taps, values, near, i))
    if any(channel.mixed for channel in channels):
        coder.finish()
    if source or states != rans.first_states(count) or literals.rest():
        raise ValueError(CORRUPT)
    columns = [
        [wrap(x + c.centre) for x in column] for c, column in zip(channels, values, strict=True)
    ]
    return np.array(columns, np.int32).T.copy()


def _symbol(zigzag: int) -> int:
    if zigzag < DIRECT:
        return zigzag
    top = zigzag.bit_length() - 1
    return DIRECT + 4 * (top - 7) + (zigzag >> (top - 2) & 3)


def _literal_bits(symbol: int) -> int:
    return 5 + (symbol - DIRECT) // 4


class _Bits:
    """Literal bits, lowest first."""

    def __init__(self, data: bytes) -> None:
        self.held, self.left = int.from_bytes(data, "little"), 8 * len(data)

    def take(self, count: int) -> int:
        if count > self.left:
            raise ValueError(CORRUPT)
        value = self.held & (1 << count) - 1
        self.held, self.left = self.held >> count, self.left - count
        return value

    def rest(self) -> bool:
        """Whether more than zeros up to the end of a byte remain."""
        return self.held != 0 or self.left >= 8


def _large(symbol: int, literals: _Bits) -> int:
    bits = _literal_bits(symbol)
    return (4 + (symbol - DIRECT) % 4) << bits | literals.take(bits)


def _take(data: bytes) -> tuple[bytes, bytes]:
    """As many bytes as a number before them says, and the rest."""
    size, at = read_varint(data, 0)
    if not 0 <= size <= len(data) - at:
        raise ValueError(CORRUPT)
    return data[at : at + size], data[at + size :]


def _table(channels: list[Channel], symbols: list[list[int]], j: int, i: int) -> list[int]:
    """The table of symbol i of channel j."""
    rows = len(symbols[0])
    first = rans.starts(rows)[rans.lane_of(rows, i)]
    return channels[j].frequency[channels[j].class_of[_cell(channels, symbols, j, i, first)]]


def _cell(channels: list[Channel], symbols: list[list[int]], j: int, i: int, first: int) -> int:
    """What the class of symbol i of channel j depends on; own rows count from ``first``."""
    channel, rows = channels[j], len(symbols[0])

    def magnitude(k: int, row: int) -> int:
        return min((symbols[k][row] + 1) // 2 * channels[k].gain >> 4, 255)

    def activity(row: int) -> int:
        return sum(magnitude(k, row) for k in range(j)) if 0 <= row < rows else 0

    own = sum((3 - back) * magnitude(j, i - back) for back in (1, 2) if i - back >= first)
    sources = own, activity(i), activity(i - 1) + activity(i + 1)
    total = sum(w * a for w, a in zip(channel.weight, sources, strict=True)) >> 10
    level = sum(total >= threshold for threshold in THRESHOLDS)
    nonzero = any(symbols[j - back][i] for back in range(1, channel.span + 1))
    return level + 32 * nonzero
