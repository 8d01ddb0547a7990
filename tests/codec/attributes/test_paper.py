"""The plain run-length coder: round trips over all of int32, agreement with the reference."""

from __future__ import annotations

import numpy as np
import pytest
from clgs.lab.bench.codec_baselines import ATTRIBUTES
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs.codec.attributes import paper, row_coder
from clgs.reference.codec import paper as reference
from tests.codec.attributes.matrices import INT32, laplace, matrices


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_size_is_that_of_the_published_coder(name, shared_data):
    """Within 1 %: the structure is the same, only the speed of adaptation is our own."""
    value = np.load(shared_data / "codec" / f"{name}.npz")["values"].astype(np.int32)
    data = paper.encode(value)
    np.testing.assert_array_equal(paper.decode(data, *value.shape), value)
    assert abs(len(data) / ATTRIBUTES[name] - 1) <= 0.01


@pytest.mark.parametrize("channels", [1, 2, 3, 7])
@pytest.mark.parametrize("name", matrices())
def test_same_bytes_as_the_reference_in_both_directions(name, channels):
    value = np.ascontiguousarray(np.resize(matrices()[name], (len(matrices()[name]), channels)))
    data = paper.encode(value)
    assert data == reference.encode(value)
    np.testing.assert_array_equal(paper.decode(data, *value.shape), value)
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
    data = paper.encode(value)
    assert len(data) <= 1 + 4 * value.size
    np.testing.assert_array_equal(paper.decode(data, *value.shape), value)


def test_the_level_paper_of_attributes_in_chunks():
    value = laplace(3, 50, 8)
    model = row_coder.fit(value, "paper", 20)
    assert model.header == b"\2"
    chunk = model.encode(value[20:40])
    assert chunk == paper.encode(value[20:40])
    np.testing.assert_array_equal(row_coder.read(b"\2", 8).decode(chunk, 20), value[20:40])


@pytest.mark.parametrize("run", [0, 1, 2, 3, 4, 10, 11, 14, 15, 22, 23, 2**16, 2**20])
def test_runs_of_every_kind(run):
    value = np.zeros((run + 2, 3), np.int32)
    value[[0, -1], [1, 2]] = 1, -1
    np.testing.assert_array_equal(paper.decode(paper.encode(value), *value.shape), value)


def test_channel_counts_out_of_range_are_refused():
    for channels in (0, 257):
        with pytest.raises(ValueError, match="rows"):
            paper.encode(np.zeros((4, channels), np.int32))


def test_wrong_row_counts_are_refused():
    value = laplace(2)
    data = paper.encode(value)
    for rows in (0, 1, len(value) - 1, len(value) + 1, 10 * len(value)):
        with pytest.raises(ValueError, match="stream"):
            paper.decode(data, rows, value.shape[1])


@pytest.mark.parametrize("name", ["laplace 1", "laplace 1000.0", "laplace 1000000.0", "extremes"])
def test_every_truncation_and_longer_streams_are_refused(name):
    value = matrices()[name]
    data = paper.encode(value)
    for size in range(len(data)):
        with pytest.raises(ValueError, match="stream"):
            paper.decode(data[:size], *value.shape)
    for more in range(1, 17):
        with pytest.raises(ValueError, match="stream"):
            paper.decode(data + bytes(more), *value.shape)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\2" + b"\0" * 20,
        b"\1",
        b"\1" + b"\xff" * 20,
        b"\1\xff\xff\xff\xff\x0f" + b"\0" * 9,
        b"\1\0" + b"\0" * 40,
    ],
)
def test_hostile_streams_are_refused(data):
    with pytest.raises(ValueError, match="stream"):
        paper.decode(data, 3, 1)


def test_sum_past_int32_is_refused():
    value = np.array([[2**31 - 1], [2**31 - 2], [2**31 - 3]] * 4, np.int32)
    data = bytearray(paper.encode(value))
    assert data[:6] == b"\1\xfc\xff\xff\xff\x0f"  # mean 2^31 - 2
    data[1:6] = b"\xfe\xff\xff\xff\x0f"  # mean 2^31 - 1: the first value becomes 2^31
    for decode in (paper.decode, reference.decode):
        with pytest.raises(ValueError, match="no encoder"):
            decode(bytes(data), 12, 1)
