"""Attributes: round trips over all of int32, agreement with the reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs.codec.attributes import runlength
from clgs.reference.codec import runlength as reference
from tests.codec.attributes.matrices import INT32, laplace, matrices


@pytest.mark.parametrize("name", matrices())
def test_same_bytes_as_the_reference_in_both_directions(name):
    value = matrices()[name]
    data = runlength.encode(value)
    assert data == reference.encode(value)
    np.testing.assert_array_equal(runlength.decode(data, *value.shape), value)
    np.testing.assert_array_equal(reference.decode(data, *value.shape), value)


@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(
        np.int32,
        st.tuples(st.integers(0, 20), st.integers(1, 8)),
        elements=st.one_of(st.just(0), st.integers(-3, 3), INT32),
    )
)
def test_round_trip(value):
    data = runlength.encode(value)
    assert len(data) <= 1 + 4 * value.size
    np.testing.assert_array_equal(runlength.decode(data, *value.shape), value)


@pytest.mark.parametrize("channels", [1, 2, 3, 256])
def test_channel_counts(channels):
    value = laplace(3, 20, channels)
    np.testing.assert_array_equal(runlength.decode(runlength.encode(value), 20, channels), value)


def test_channel_counts_out_of_range_are_refused():
    for channels in (0, 257):
        with pytest.raises(ValueError, match="rows"):
            runlength.encode(np.zeros((4, channels), np.int32))


def test_zero_rows_cost_next_to_nothing():
    assert len(runlength.encode(np.zeros((1_000_000, 30), np.int32))) <= 40


def test_noise_is_never_longer_than_raw():
    value = np.random.default_rng(3).integers(-(2**31), 2**31, (300, 6), dtype=np.int64)
    value = value.astype(np.int32)
    data = runlength.encode(value)
    assert len(data) <= 1 + 4 * value.size
    np.testing.assert_array_equal(runlength.decode(data, 300, 6), value)


def test_read_only_and_strided_arrays_are_taken_as_they_are():
    value = laplace(2, 40, 8)
    wide = np.repeat(value, 2, axis=1)[:, ::2]
    wide.setflags(write=False)
    assert runlength.encode(wide) == runlength.encode(value)
    assert runlength.encode(np.asfortranarray(value)) == runlength.encode(value)


def test_wrong_row_counts_are_refused():
    value = laplace(2)
    data = runlength.encode(value)
    for rows in (0, 1, len(value) - 1, len(value) + 1, 10 * len(value)):
        with pytest.raises(ValueError, match="stream"):
            runlength.decode(data, rows, value.shape[1])


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\2" + b"\0" * 20,
        b"\1",
        b"\1" + b"\xff" * 20,
        b"\1" + b"\x80" * 4 + b"\x7f" + b"\0" * 9,
        b"\1\xff\xff\xff\xff\x0f" + b"\0" * 9,
    ],
)
def test_hostile_streams_are_refused(data):
    with pytest.raises(ValueError, match="stream"):
        runlength.decode(data, 3, 1)


def test_sum_past_int32_is_refused():
    value = np.array([[2**31 - 1], [2**31 - 2], [2**31 - 3]], np.int32)
    data = bytearray(runlength.encode(value))
    assert data[0] == 1
    assert data[1:6] == b"\xfc\xff\xff\xff\x0f"  # centre 2^31 - 2
    data[1:6] = b"\xfe\xff\xff\xff\x0f"  # centre 2^31 - 1: the first value becomes 2^31
    with pytest.raises(ValueError, match="no encoder"):
        runlength.decode(bytes(data), 3, 1)
    with pytest.raises(ValueError, match="no encoder"):
        reference.decode(bytes(data), 3, 1)
