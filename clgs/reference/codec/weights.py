"""MLP weights as multiples of powers of two, for reading (FORMAT.md on MLPS); same bytes as C."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgs.reference.codec import planes
from clgs.reference.codec.coding import Coder, RangeDecoder, RangeEncoder
from clgs.reference.codec.runlength import CORRUPT, Symbol

MODE = 2
SIGNIFICAND = 1 << 24
"""Multiples are below this, so that every one is exact as a float."""
STEP_BIAS, LAST_STEP = 150, 254
LIMIT = 1000

Matrices = Sequence[tuple[int, int]]


def encode(weights: npt.NDArray[np.float32], matrices: Matrices) -> bytes:
    """The shorter stream of ``weights`` (n,) float32: planes, or multiples if they are.

    ``matrices``: (rows, columns) of each, one after another in ``weights``.
    """
    as_planes = planes.encode(weights)
    steps, multiples, first = [], [], 0
    for rows, columns in matrices:
        part = weights[first : first + rows * columns]
        step = find_step(part)
        if step is None:
            return as_planes
        steps.append(step)
        multiples.append([int(Fraction(float(x)) / _step(step)) for x in part] if step else [])
        first += rows * columns
    coder = RangeEncoder()
    symbol = Symbol((LIMIT,))
    for shape, step, values in zip(matrices, steps, multiples, strict=True):
        if step:
            _code_matrix(coder, symbol, shape, values)
    coded = bytes([MODE, *steps]) + coder.finish()
    return coded if len(coded) < len(as_planes) else as_planes


def decode(data: bytes, matrices: Matrices) -> npt.NDArray[np.float32]:
    """The weights (n,) float32.

    Raises:
        ValueError: the stream is damaged.
    """
    if data[0] != MODE:
        return planes.decode(data, sum(rows * columns for rows, columns in matrices))
    steps = data[1 : 1 + len(matrices)]
    if max(steps) > LAST_STEP:
        raise ValueError(CORRUPT)
    coder, symbol = RangeDecoder(data[1 + len(matrices) :]), Symbol((LIMIT,))
    weights: list[float] = []
    for shape, step in zip(matrices, steps, strict=True):
        if step:
            values = _code_matrix(coder, symbol, shape, None)
            weights += [math.ldexp(value, step - STEP_BIAS) for value in values]
        else:
            weights += [0.0] * (shape[0] * shape[1])
    coder.finish()
    return np.array(weights, np.float32)


def find_step(weights: npt.NDArray[np.float32]) -> int | None:
    """The stored byte of the coarsest step that all weights are multiples of, 0 if all are 0.

    None if there is no step, or the multiples reach 2^24, or a weight is -0.
    """
    if not np.isfinite(weights).all() or np.any((weights == 0) & np.signbit(weights)):
        return None
    exact = [Fraction(float(x)) for x in weights if x != 0]
    if not exact:
        return 0
    least = min(_lowest_bit(x) for x in exact)
    step = min(least + STEP_BIAS, LAST_STEP)
    return step if max(abs(x) for x in exact) / _step(step) < SIGNIFICAND else None


def _step(stored: int) -> Fraction:
    return Fraction(2) ** (stored - STEP_BIAS)


def _lowest_bit(x: Fraction) -> int:
    """Exponent of the lowest bit of a number with a power of two below the line."""
    top = abs(x.numerator)
    return (top & -top).bit_length() - x.denominator.bit_length()


def _code_matrix(
    coder: Coder, symbol: Symbol, shape: tuple[int, int], values: list[int] | None
) -> list[int]:
    """Code one matrix row by row; the sizes of earlier values tell how large the next will be."""
    rows, columns = shape
    above = [0] * columns
    done: list[int] = []
    for i in range(rows):
        before, expected_before = 0, 0
        for j in range(columns):
            mean = 16 * (sum(above) + before + 32) // (len(done) + 1)
            column = (16 * above[j] + 16 * mean) // (i + 16)
            ratio = 256 * (16 * before + 48 * mean + 1) // (expected_before + 48 * mean + 1)
            expected = max(1, column * min(ratio, 65535) // 256)
            value = _code_value(coder, symbol, expected, values[len(done)] if values else 0)
            done.append(value)
            before += abs(value)
            expected_before += column
        above = [a + abs(x) for a, x in zip(above, done[-columns:], strict=True)]
    return done


def _code_value(coder: Coder, symbol: Symbol, expected: int, value: int) -> int:
    """Code one multiple; ``expected`` is its expected magnitude in 1/16."""
    top = expected.bit_length() - 1
    shift = min(max(top - 5, 0), 23)
    symbol.contexts = (4 * min(top, 6) + (4 * expected >> top & 3),)
    size = symbol.size(coder, (abs(value) >> shift) + 1) - 1
    for place in range(shift - 1, -1, -1):
        size = 2 * size + coder.code(abs(value) >> place & 1, 32768)
    if size >= SIGNIFICAND:
        raise ValueError(CORRUPT)
    if size == 0:
        return 0
    return -size if coder.code(int(value < 0), 32768) else size
