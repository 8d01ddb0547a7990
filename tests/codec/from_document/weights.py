"""Part 9: the weights of the three networks."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from tests.codec.from_document.common import ByteReader, check
from tests.codec.from_document.entropy import RangeDecoder, State, decode_size, mix

OUTPUTS = (10, 30, 70)
MATRICES = [shape for m in OUTPUTS for shape in ((50, 53), (50, 1), (m, 50), (m, 1))]
COUNT = 13710


def decode_weights(data: bytes, matrices: list[tuple[int, int]] | None = None) -> np.ndarray:
    """All weights as f32; other `matrices` are for examples only."""
    matrices = MATRICES if matrices is None else matrices
    count = sum(rows * columns for rows, columns in matrices)
    reader = ByteReader(data, "MLPS")
    mode = reader.number("B")
    check(mode in (0, 1, 2), f"MLPS: mode {mode}")
    if mode == 0:
        check(reader.left == 4 * count, "MLPS: mode 0 of a wrong length")
        weights = np.frombuffer(reader.rest(), "<f4").copy()
    elif mode == 1:
        weights = _planes(reader.rest(), count)
    else:
        steps = list(reader.take(len(matrices)))
        check(255 not in steps, "MLPS: step 255")
        weights = Multiples(reader.rest()).decode(matrices, steps)
    check(bool(np.isfinite(weights).all()), "MLPS: a weight is not finite")
    return weights


def _planes(data: bytes, count: int) -> np.ndarray:
    """Mode 1 (9.1)."""
    coder = RangeDecoder(data, "MLPS")
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


class Multiples:
    """Mode 2 (9.2)."""

    def __init__(self, data: bytes) -> None:
        self.coder = RangeDecoder(data, "MLPS")
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
