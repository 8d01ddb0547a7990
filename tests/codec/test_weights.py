"""Weights of the MLPs: bit for bit, for all values (their bytes: test_conformance)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs.codec.meta import pack_weights, unpack_weights
from clgs.scene.mlps import MATRICES, MLP_SIZE, init_mlps

FLOATS = npst.from_dtype(np.dtype(np.float32))
PLANES, MULTIPLES = 1, 2
SHAPES = ((6, 9), (9, 1), (4, 30), (1, 17))
COUNT = sum(rows * columns for rows, columns in SHAPES)


def drawn(step: float, spread: float = 0.1, count: int = COUNT) -> np.ndarray:
    """Normal weights, rounded to multiples of ``step`` if it is not 0; never -0."""
    x = np.random.default_rng(4).normal(0, spread, count)
    x = np.rint(x / step) * step if step else x
    return (x + 0.0).astype(np.float32)


def assert_round_trip(x: np.ndarray, mode: int | None = None) -> bytes:
    data = pack_weights(x, matrices=SHAPES)
    assert mode is None or data[0] == mode
    assert len(data) <= 1 + 4 * x.size
    np.testing.assert_array_equal(unpack_weights(data, SHAPES).view(np.uint32), x.view(np.uint32))
    return data


def test_every_matrix_has_a_step_of_its_own():
    x = drawn(2.0**-9)
    x[:54] = drawn(2.0**-12, count=54)
    x[63:183] = 0
    data = assert_round_trip(x, MULTIPLES)
    assert list(data[1:5]) == [150 - 12, 150 - 9, 0, 150 - 9]


@pytest.mark.parametrize(
    "pair", [(-0.0, 1.0), (np.inf, 1.0), (np.nan, 1.0), (1.0, 2.0**-24), (2.0**127, 2.0**-149)]
)
def test_what_is_no_multiple_stays_float(pair):
    x = drawn(2.0**-6)
    x[3], x[4] = pair
    assert_round_trip(x, PLANES)


def test_float32_on_request():
    x = drawn(2.0**-6)
    data = pack_weights(x, "float32")
    assert data[0] == PLANES
    np.testing.assert_array_equal(unpack_weights(data, SHAPES), x)


@settings(max_examples=30, deadline=None)
@given(npst.arrays(np.float32, COUNT, elements=FLOATS))
def test_any_floats_survive_bit_for_bit(x):
    assert_round_trip(x)


@settings(max_examples=30, deadline=None)
@given(
    npst.arrays(np.int32, COUNT, elements=st.integers(1 - 2**24, 2**24 - 1)), st.integers(-149, 104)
)
def test_any_multiples_survive(n, exponent):
    x = np.ldexp(n.astype(np.float64), exponent).astype(np.float32)
    assert_round_trip(x)


def test_after_many_zeros_the_least_is_expected():
    """Magnitudes expected below 1/16 count as 1/16."""
    x = np.zeros(4000, np.float32)
    x[-1] = 0.5
    data = pack_weights(x, matrices=((1000, 4),))
    np.testing.assert_array_equal(unpack_weights(data, ((1000, 4),)), x)


def test_standard_sizes_cost_their_entropy():
    """Within 1 % of the entropy of the drawn normal law, 13,710 weights of twelve matrices."""
    x = drawn(2.0**-8, 0.1, MLP_SIZE)
    entropy = MLP_SIZE * np.log2(0.1 * 2.0**8 * np.sqrt(2 * np.pi * np.e)) / 8
    assert len(pack_weights(x)) <= 1.01 * entropy
    start = init_mlps(np.random.default_rng(0)).flat
    np.testing.assert_array_equal(unpack_weights(pack_weights(start)), start)


def test_large_rows_and_columns_are_learnt():
    """A row and a column of a hundred times the size cost less than without their places."""
    x = drawn(2.0**-8, 0.1, 2500).reshape(50, 50)
    x[:, 7] *= 100
    x[20] *= 100
    data = pack_weights(x.ravel(), matrices=((50, 50),))
    shuffled = np.random.default_rng(0).permutation(x.ravel())
    assert len(data) < 0.97 * len(pack_weights(shuffled, matrices=((50, 50),)))


def test_damage_is_an_error_or_other_weights():
    x = drawn(2.0**-6)
    data = pack_weights(x, matrices=SHAPES)
    for size in range(len(data)):
        with pytest.raises(ValueError, match="stream"):
            unpack_weights(data[:size], SHAPES)
    for tail in (b"\0", b"\0" * 16):
        with pytest.raises(ValueError, match="stream"):
            unpack_weights(data + tail, SHAPES)
    for at in range(8 * (len(data) - 1)):  # of the last byte, bits may not matter
        damaged = bytearray(data)
        damaged[at // 8] ^= 1 << at % 8
        try:
            other = unpack_weights(bytes(damaged), SHAPES)
        except ValueError:
            continue
        assert not np.array_equal(other.view(np.uint32), x.view(np.uint32))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\2",
        b"\3" + b"\0" * 20,
        b"\2" + b"\x94" * 3,
        b"\2" + b"\xff" * 4 + b"\0" * 9,
        b"\2" + b"\x94" * 4,
        b"\2" + b"\x94" * 4 + b"\xff" * 400,
        b"\2" + b"\0" * 4,
        b"\2" + b"\0" * 4 + b"\0\0",
    ],
)
def test_hostile_streams_are_refused(data):
    with pytest.raises(ValueError, match="stream"):
        unpack_weights(data, SHAPES)


@pytest.mark.parametrize("matrices", [(), ((6, 9),), ((COUNT, 2),), ((1, COUNT), (0, 5), (1, 1))])
def test_matrices_that_hold_other_numbers_are_refused(matrices):
    with pytest.raises(ValueError, match="layers"):
        pack_weights(drawn(0.5), matrices=matrices)


def test_matrices_out_of_range_are_refused():
    for matrices in (((1, 1025),), ((2**20 + 1, 1),), ((1, 1),) * 65):
        x = np.zeros(sum(rows * columns for rows, columns in matrices), np.float32)
        with pytest.raises(ValueError, match="layers"):
            pack_weights(x, matrices=matrices)


def test_the_default_matrices_are_the_mlps():
    assert sum(rows * columns for rows, columns in MATRICES) == MLP_SIZE
    assert len(MATRICES) == 12
