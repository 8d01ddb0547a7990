"""Positions whose differences share a factor: their streams hold the factors."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs import codec
from clgs.codec import streams
from clgs.errors import CodecError
from tests.codec.samples import cloud, in_order, sealed

HEAD = struct.Struct("<4sIIII")


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 400),
    extent=st.integers(1, 500),
    factors=st.tuples(*[st.integers(1, 4096)] * 3),
    corner=st.tuples(*[st.integers(-(2**31), 2**31 - 1 - 499 * 4096)] * 3),
)
def test_every_lattice_comes_back(seed, count, extent, factors, corner):
    position = cloud(count, seed, extent) * factors + corner
    data = codec.encode_positions(position)
    assert np.array_equal(codec.decode_positions(data), in_order(position))


@pytest.mark.parametrize(
    "factors", [(2, 2, 2), (3, 3, 3), (1, 5, 64), (1000, 1000, 1), (7, 11, 13)]
)
def test_a_lattice_costs_its_head(factors):
    position = cloud(3000, 0, 300)
    plain = codec.encode_positions(position)
    data = codec.encode_positions(position * factors - 10**6)
    assert data[:4] == streams.LATTICE
    assert HEAD.unpack_from(data)[2:] == factors
    assert len(data) <= len(plain) + 32  # the head, and origins


def test_one_factor_in_many_chunks(monkeypatch):
    monkeypatch.setattr(streams, "POINTS", 1000)
    position = cloud(3000, 1, 100) * (6, 6, 6)
    assert len(position) > 2 * streams.POINTS
    one, two = (codec.encode_positions(position, threads) for threads in (1, 2))
    assert one == two
    assert np.array_equal(codec.decode_positions(one), in_order(position))
    assert len(one) < len(codec.encode_positions(position // 6)) + 64


def test_without_a_factor_or_a_gain_no_factors_are_written():
    for position in (cloud(500, 2, 64), [[5, 5, 5]], [[0, 0, 0], [2, 0, 0]], np.empty((0, 3), int)):
        assert codec.encode_positions(np.array(position))[:4] == streams.POSITIONS


def test_points_on_a_lattice_may_be_written_without_factors(monkeypatch):
    position = cloud(2000, 6, 200) * (3, 1, 8)
    monkeypatch.setattr(streams, "common_factors", lambda position: [1, 1, 1])
    data = codec.encode_positions(position)
    assert data[:4] == streams.POSITIONS
    assert np.array_equal(codec.decode_positions(data), in_order(position))


def resealed(data, count, factors):
    return sealed(HEAD.pack(streams.LATTICE, count, *factors) + data[HEAD.size : -4])


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((0, 2, 2), "factors"),
        ((2, 2, 2**21 + 1), "factors"),
        ((2**32 - 1, 2, 2), "factors"),
        ((2**20, 2, 2), "position: x spans"),
    ],
)
def test_impossible_factors_are_refused(factors, said):
    position = cloud(2000, 3, 200) * 2
    data = codec.encode_positions(position)
    with pytest.raises(CodecError, match=rf"^stream at byte \d+: {said}"):
        codec.decode_positions(resealed(data, len(position), factors))


def test_a_lattice_beyond_int32_is_refused():
    position = cloud(2000, 4, 200) * 2 + (2**31 - 1000)
    data = codec.encode_positions(position)
    with pytest.raises(CodecError, match="leaves the range of int32"):
        codec.decode_positions(resealed(data, len(position), (2, 2, 50)))


def test_a_lattice_of_no_points_is_refused():
    with pytest.raises(CodecError, match="of 0 points"):
        codec.decode_positions(sealed(HEAD.pack(streams.LATTICE, 0, 2, 2, 2)))


def test_every_flip_and_every_cut_is_an_error():
    data = codec.encode_positions(cloud(60, 5, 40) * (3, 4, 5))
    assert data[:4] == streams.LATTICE
    for bit in (*range(8 * HEAD.size), *range(8 * HEAD.size, 8 * len(data), 9)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(CodecError):
            codec.decode_positions(flipped)
    for length in range(len(data)):
        with pytest.raises(CodecError):
            codec.decode_positions(data[:length])
