"""Static rANS of attribute symbols, for reading (FORMAT.md on rANS): states, words and lanes."""

from __future__ import annotations

import numpy as np

LANES, LONG_ROWS, SCALE_BITS, LOW = 8, 2048, 12, 1 << 16


def _lanes(rows: int) -> int:
    return 1 if rows < LONG_ROWS else LANES


def first_states(rows: int) -> list[int]:
    """States of an encoder before its first symbol."""
    return [1] if rows < LONG_ROWS else [LOW] * LANES


def split_words(data: bytes, rows: int) -> tuple[list[int], list[int]]:
    """States before the first symbol to decode, and words."""
    lanes = _lanes(rows)
    size = 4 * lanes
    if lanes == 1 and data:
        size = len(data) if len(data) <= 4 else 4 - len(data) % 2
    states = [data[:size]] if lanes == 1 else [data[i : i + 4] for i in range(0, size, 4)]
    words = np.frombuffer(data, "<u2", offset=size) if data else np.empty(0)
    return [int.from_bytes(state, "little") for state in states], [int(word) for word in words]


def starts(rows: int) -> list[int]:
    """First rows of the lanes, and the number of rows."""
    lanes = _lanes(rows)
    return [rows // lanes * lane + min(lane, rows % lanes) for lane in range(lanes + 1)]


def lane_of(rows: int, i: int) -> int:
    """The lane of row ``i``."""
    return max(lane for lane in range(_lanes(rows)) if starts(rows)[lane] <= i)


def coding_order(rows: int) -> list[int]:
    """The first row of every lane, then the second of every lane, and so on."""
    first = starts(rows)
    return [
        first[lane] + step
        for step in range(-(-rows // _lanes(rows)))
        for lane in range(_lanes(rows))
        if first[lane] + step < first[lane + 1]
    ]


def encode_symbols(order: list[tuple[list[int], int]], rows: int) -> bytes:
    """Final states and words, for tables and symbols in the order of decoding."""
    lanes = [lane_of(rows, i) for i in coding_order(rows)] * (len(order) // rows)
    states, words = first_states(rows), []
    for lane, (table, symbol) in zip(reversed(lanes), reversed(order), strict=True):
        state, frequency = states[lane], table[symbol]
        if state >= frequency << 20:
            words.append(state & 0xFFFF)
            state >>= 16
        start = sum(table[:symbol])
        states[lane] = (state // frequency << SCALE_BITS) + start + state % frequency
    head = np.array(states, "<u4").tobytes()
    if len(states) == 1:
        head = head[: (states[0].bit_length() + 7) // 8]
    return head + np.array(words[::-1], "<u2").tobytes()


def decode_symbol(state: int, table: list[int], words: list[int]) -> tuple[int, int]:
    """A symbol, and the state after it, which may take the first word."""
    place = state % (1 << SCALE_BITS)
    symbol, start = 0, 0
    while start + table[symbol] <= place:
        start += table[symbol]
        symbol += 1
    state = table[symbol] * (state >> SCALE_BITS) + place - start
    return symbol, state << 16 | words.pop(0) if state < LOW and words else state
