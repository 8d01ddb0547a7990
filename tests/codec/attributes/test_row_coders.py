"""The two coders of plain rows: round trips over all of int32, and refusal of damage.

Their bytes are those of ``test_conformance``.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs.codec import row_coder
from clgs.lab.bench.codec import PUBLISHED_ATTRIBUTES as ATTRIBUTES
from codec_c.reader.rows import decode_paper_rows, decode_rows
from tests.codec.samples import (
    INT32,
    decode_paper,
    decode_run_lengths,
    draw,
    encode_paper,
    encode_run_lengths,
    matrices,
)

CODERS = {
    "run lengths": (encode_run_lengths, decode_run_lengths),
    "paper": (encode_paper, decode_paper),
}
MANY = pytest.mark.parametrize(("encode", "decode"), CODERS.values(), ids=CODERS)


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_size_is_that_of_the_published_coder(name, shared_data):
    """Within 1 %: the structure is the same, only the speed of adaptation is our own."""
    value = np.load(shared_data / "codec" / f"{name}.npz")["values"].astype(np.int32)
    data = encode_paper(value)
    np.testing.assert_array_equal(decode_paper(data, *value.shape), value)
    assert abs(len(data) / ATTRIBUTES[name] - 1) <= 0.01


@MANY
@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(
        np.int32,
        st.tuples(st.integers(0, 20), st.integers(1, 8)),
        elements=st.one_of(st.just(0), st.integers(-3, 3), INT32),
    )
)
def test_round_trip(encode, decode, value):
    data = encode(value)
    assert len(data) <= 1 + 4 * value.size
    np.testing.assert_array_equal(decode(data, *value.shape), value)


@MANY
@pytest.mark.parametrize("channels", [1, 2, 3, 256])
def test_channel_counts(encode, decode, channels):
    value = draw(20, channels, 9)
    np.testing.assert_array_equal(decode(encode(value), 20, channels), value)


@MANY
def test_channel_counts_out_of_range_are_refused(encode, decode):
    for channels in (0, 257):
        with pytest.raises(ValueError, match="rows"):
            encode(np.zeros((4, channels), np.int32))


def test_the_level_paper_of_attributes_in_chunks():
    value = draw(50, 8, 9)
    model = row_coder.fit(value, "paper", 20)
    assert model.header == b"\2"
    chunk = model.encode(value[20:40])
    assert chunk == encode_paper(value[20:40])
    np.testing.assert_array_equal(row_coder.read(b"\2", 8).decode(chunk, 20), value[20:40])


@pytest.mark.parametrize("run", [0, 1, 2, 3, 4, 10, 11, 14, 15, 22, 23, 2**16, 2**20])
def test_runs_of_every_kind(run):
    value = np.zeros((run + 2, 3), np.int32)
    value[[0, -1], [1, 2]] = 1, -1
    np.testing.assert_array_equal(decode_paper(encode_paper(value), *value.shape), value)


def test_zero_rows_cost_next_to_nothing():
    assert len(encode_run_lengths(np.zeros((1_000_000, 30), np.int32))) <= 40


@MANY
def test_wrong_row_counts_are_refused(encode, decode):
    value = matrices()["triplets"]
    data = encode(value)
    for rows in (0, 1, len(value) - 1, len(value) + 1, 10 * len(value)):
        with pytest.raises(ValueError, match="stream"):
            decode(data, rows, value.shape[1])


@pytest.mark.parametrize("name", ["spread 3", "spread 3000", "spread 4194304", "extremes"])
def test_every_truncation_and_longer_streams_are_refused(name):
    value = matrices()[name][:60]
    data = encode_paper(value)
    for size in range(len(data)):
        with pytest.raises(ValueError, match="stream"):
            decode_paper(data[:size], *value.shape)
    for more in range(1, 17):
        with pytest.raises(ValueError, match="stream"):
            decode_paper(data + bytes(more), *value.shape)


@MANY
@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\2" + b"\0" * 20,
        b"\1",
        b"\1" + b"\xff" * 20,
        b"\1" + b"\x80" * 4 + b"\x7f" + b"\0" * 9,
        b"\1\xff\xff\xff\xff\x0f" + b"\0" * 9,
        b"\1\0" + b"\0" * 40,
    ],
)
def test_hostile_streams_are_refused(encode, decode, data):
    with pytest.raises(ValueError, match="stream"):
        decode(data, 3, 1)


@pytest.mark.parametrize(
    ("encode", "decode", "other", "copies"),
    [
        (encode_run_lengths, decode_run_lengths, decode_rows, 1),
        (encode_paper, decode_paper, decode_paper_rows, 4),
    ],
    ids=CODERS,
)
def test_sum_past_int32_is_refused(encode, decode, other, copies):
    value = np.array([[2**31 - 1], [2**31 - 2], [2**31 - 3]] * copies, np.int32)
    data = bytearray(encode(value))
    assert data[:6] == b"\1\xfc\xff\xff\xff\x0f"  # mean 2^31 - 2
    data[1:6] = b"\xfe\xff\xff\xff\x0f"  # mean 2^31 - 1: the first value becomes 2^31
    with pytest.raises(ValueError, match="no encoder"):
        decode(bytes(data), 3 * copies, 1)
    with pytest.raises(ValueError, match="outside of int32"):
        other(bytes(data), 3 * copies, 1)
