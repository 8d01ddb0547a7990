"""Positions: round trips, and refusal of what is not a point set (bytes: test_conformance)."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs.codec import octree
from clgs.errors import CodecError
from codec_c.reader.octree import decode_octree
from tests.codec.samples import clouds


def sorted_unique(position: np.ndarray) -> np.ndarray:
    position = np.unique(position, axis=0).astype(np.int32)
    return position[octree.morton_order(position)]


@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(np.int32, st.tuples(st.integers(1, 60), st.just(3)), elements=st.integers(0, 40)),
    st.integers(0, 15),
    st.integers(-(2**31), 2**30),
)
def test_round_trip(position, shift, origin):
    position = sorted_unique((position.astype(np.int64) << shift) + origin)
    data = octree.encode(position)
    np.testing.assert_array_equal(octree.decode(data, len(position)), position)


def test_raw_codes_stand_in_for_a_stream_that_grows():
    position = np.array([[3, 1, 2], [4, 1, 2]], np.int32)
    raw = bytes([0, 1]) + np.array([3, 1, 2], "<i4").tobytes() + np.array([0, 4], "<u8").tobytes()
    np.testing.assert_array_equal(octree.decode(raw, 2), position)
    assert decode_octree(raw, 2) == position.tolist()


def test_raw_codes_lie_in_the_cell_that_the_depth_gives():
    origin = np.zeros(3, "<i4").tobytes()
    for depth in range(22):
        codes = [8**depth - 1, 8**depth]
        data = [bytes([0, depth]) + origin + np.array([code], "<u8").tobytes() for code in codes]
        assert octree.decode(data[0], 1).max() == 2**depth - 1
        with pytest.raises(ValueError, match="holds what no encoder writes"):
            octree.decode(data[1], 1)


def test_morton_order_has_x_highest_and_sorts_negative_cells():
    position = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, 0, 0]], np.int32)
    order = octree.morton_order(position)
    assert position[order].tolist() == [[-1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]]


def test_empty_cloud_is_an_empty_stream():
    assert octree.encode(np.empty((0, 3), np.int32)) == b""
    assert octree.decode(b"", 0).shape == (0, 3)
    with pytest.raises(ValueError, match="follow"):
        octree.decode(b"\0", 0)


def test_twins_and_wide_extents_are_refused_by_name():
    with pytest.raises(CodecError, match=r"rows 0 and 2 share cell \[1, 2, 3\]"):
        octree.morton_order(np.array([[1, 2, 3], [4, 5, 6], [1, 2, 3]], np.int32))
    with pytest.raises(CodecError, match="y spans 2097153 integers"):
        octree.morton_order(np.array([[0, -1, 0], [0, 2**21 - 1, 0]], np.int32))
    with pytest.raises(CodecError, match="z spans 4294967296 integers"):
        octree.morton_order(np.array([[0, 0, -(2**31)], [0, 0, 2**31 - 1]], np.int32))


@pytest.mark.parametrize("rows", [[[0, 0, 1], [0, 0, 0]], [[0, 0, 0], [0, 0, 0]]])
def test_the_coder_itself_refuses_wrong_order(rows):
    with pytest.raises(ValueError, match="cannot be encoded"):
        octree.encode(np.array(rows, np.int32))


def test_wrong_counts_are_refused():
    position = sorted_unique(clouds()["surface"])
    data = octree.encode(position)
    for count in (1, len(position) - 1, len(position) + 1, 2 * len(position)):
        with pytest.raises(ValueError, match="stream"):
            octree.decode(data, count)
    with pytest.raises(ValueError, match="cannot hold"):
        octree.decode(data, len(data) * octree.MAX_POINTS_PER_BYTE + 1)


def raw(*codes: int) -> bytes:
    return bytes([0, 1]) + bytes(12) + np.array(codes, "<u8").tobytes()


def test_damaged_raw_codes_are_refused():
    good = raw(0, 4)
    np.testing.assert_array_equal(octree.decode(good, 2), [[0, 0, 0], [1, 0, 0]])
    for bad in (good[:-1], good + b"\0", good[:14], good[:13], raw(4, 0), raw(4, 4), raw(0, 2**63)):
        with pytest.raises(ValueError, match="stream"):
            octree.decode(bad, 2)


def test_raw_positions_past_int32_are_refused():
    data = bytes([0, 2]) + np.array([2**31 - 1] * 3, "<i4").tobytes() + (8).to_bytes(8, "little")
    with pytest.raises(ValueError, match="stream"):
        octree.decode(data, 1)


def test_coded_positions_past_int32_are_refused():
    data = octree.encode(np.array([[0, 0, 0], [0, 0, 1]], np.int32))
    assert data[2:5] == bytes(3)
    far = data[:4] + bytes([0xFE, 0xFF, 0xFF, 0xFF, 0x0F]) + data[5:]
    with pytest.raises(ValueError, match="no encoder"):
        octree.decode(far, 2)


@pytest.mark.parametrize(
    "head",
    ["02", "0200", "0216000000", "0201800000", "020180000000", "0201808080808000", "0102", "03"],
)
def test_headers_that_no_encoder_writes(head):
    data = bytes.fromhex(head)
    for more in (b"", bytes(20), b"\xff" * 20):
        with pytest.raises(ValueError, match="stream"):
            octree.decode(data + more, 2)


@pytest.mark.parametrize("name", ["surface", "thinned", "scattered", "chain", "clusters"])
def test_every_cut_and_every_longer_stream_is_refused(name):
    position = sorted_unique(clouds()[name])
    data = octree.encode(position)
    for size in {*range(len(data))[:40], *range(0, len(data), 5), *range(len(data))[-8:]}:
        with pytest.raises(ValueError, match=r"stream|cannot hold"):
            octree.decode(data[:size], len(position))
    for more in (1, 2, 9):
        with pytest.raises(ValueError, match="stream"):
            octree.decode(data + bytes(more), len(position))


@settings(max_examples=100, deadline=None)
@given(st.binary(min_size=1, max_size=200), st.integers(0, 21), st.integers(1, 300))
@example(b"\xfc\xef", 2, 2)  # points none of which touches the origin's faces
def test_noise_ends_with_an_error_or_with_points_in_order(payload, depth, count):
    data = bytes([2, depth, 0, 0, 0]) + payload
    try:
        position = octree.decode(data, count)
    except ValueError:
        return
    with_origin = np.concatenate([np.zeros((1, 3), np.int32), position])  # the stream's, not theirs
    assert octree.ascends(octree.morton_codes(with_origin)[1:])


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 7))
def test_flipped_bits_do_no_harm(place, bit):
    position = sorted_unique(clouds()["surface"])
    data = bytearray(octree.encode(position))
    data[place % len(data)] ^= 1 << bit
    with contextlib.suppress(ValueError):
        assert octree.decode(bytes(data), len(position)).shape == position.shape
