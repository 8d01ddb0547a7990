"""Attributes in chunks: round trips over all of int32, damage, sizes (bytes: test_conformance)."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs.codec import row_coder
from tests.codec.samples import INT32, draw, matrices, mixed_model, tables_model

LEVEL = st.sampled_from(row_coder.LEVELS)


def mixture(rows: int = 800) -> np.ndarray:
    """Channels that follow each other and their own past."""
    walk = np.cumsum(draw(rows, 3, 9), axis=0)
    followers = walk.sum(axis=1) + draw(rows, 1, 3)[:, 0]
    return np.column_stack([walk, followers, -walk[:, 1]]).astype(np.int32)


def encode(value: np.ndarray, level: str, chunk: int) -> tuple[bytes, list[bytes]]:
    model = row_coder.fit(value, level, chunk)
    return model.header, [model.encode(value[i : i + chunk]) for i in range(0, len(value), chunk)]


def decode(header: bytes, chunks: list[bytes], rows: int, channels: int, chunk: int) -> np.ndarray:
    model = row_coder.read(header, channels)
    parts = [model.decode(c, min(chunk, rows - i * chunk)) for i, c in enumerate(chunks)]
    return np.concatenate([np.empty((0, channels), np.int32), *parts])


def assert_round_trip(value: np.ndarray, level: str, chunk: int) -> int:
    """Check that it decodes to the same; the number of its bytes."""
    header, chunks = encode(value, level, chunk)
    np.testing.assert_array_equal(decode(header, chunks, *value.shape, chunk), value)
    return len(header) + sum(map(len, chunks))


@pytest.mark.parametrize("level", row_coder.LEVELS)
@pytest.mark.parametrize("chunk", [256, row_coder.CHUNK])
@pytest.mark.parametrize("name", [*matrices(), "no rows"])
def test_round_trip(name, chunk, level):
    value = matrices().get(name, np.empty((0, 5), np.int32))
    size = assert_round_trip(value, level, chunk)
    assert size <= 1 + 4 * value.size + (-(-len(value) // chunk) if level == "paper" else 0)


@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(
        np.int32,
        st.tuples(st.integers(0, 70), st.integers(1, 6)),
        elements=st.one_of(st.just(0), st.integers(-3, 3), st.integers(-200, 200), INT32),
    ),
    LEVEL,
    st.integers(1, 40),
)
def test_round_trip_of_anything(value, level, chunk):
    assert_round_trip(value, level, chunk)


def test_channel_counts_out_of_range_are_refused():
    for channels in (0, 257):
        with pytest.raises(ValueError, match="channels"):
            row_coder.fit(np.zeros((4, channels), np.int32))


def test_unknown_levels_are_refused():
    with pytest.raises(ValueError, match="level 'best'"):
        row_coder.fit(draw(300, 4, 3), "best")


def test_mixing_pays_where_channels_follow_others_loosely():
    value = mixture(8000)
    model = row_coder.fit(value, "max").tables
    assert model["coder"].any()
    assert not model["coder"].all() or len(model) > 1
    assert assert_round_trip(value, "max", 3000) < assert_round_trip(value, "default", 3000)


@pytest.mark.parametrize("chunk", [256, 65536])
@pytest.mark.parametrize("name", matrices())
def test_max_is_never_longer_than_default(name, chunk):
    value = matrices()[name]
    assert assert_round_trip(value, "max", chunk) <= assert_round_trip(value, "default", chunk)


@pytest.mark.parametrize("level", ["fast", "default", "max"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 256), (20, 50), (200, 6), (1000, 30)])
def test_small_matrices_are_no_longer_than_the_plain_coder_makes_them(shape, level):
    value = draw(*shape, 9)
    plain = assert_round_trip(value, "paper", 65536)
    assert assert_round_trip(value, level, 65536) <= min(plain, 1 + 4 * value.size)


def test_short_chunks_are_not_mixed():
    value = mixture(8000)
    model = row_coder.fit(value, "max", 255)
    assert model.tables is None or not model.tables["coder"].any()
    assert row_coder.fit(value, "max", 3000).tables["coder"].any()


@pytest.mark.parametrize("name", ["extremes", "spread 4194304", "mixture", "shifted"])
def test_mixed_channels_take_any_values(name):
    value = matrices()[name]
    rows = np.concatenate([value, draw(300, value.shape[1], 3)])
    model = mixed_model(rows)
    np.testing.assert_array_equal(model.decode(model.encode(rows), len(rows)), rows)


def test_constant_rows_cost_next_to_nothing():
    assert assert_round_trip(np.full((200_000, 30), 7, np.int32), "default", 65536) <= 300


def outcome(call, *arguments):
    """What the call returns, or the message of its ValueError, which must name the stream."""
    try:
        return call(*arguments)
    except ValueError as error:
        return re.search("stream", str(error)).string


def damaged(data: bytes, every: int = 400):
    """Truncations, extensions, and flips: of ``every`` bit at the start, then one bit per byte.

    Cuts: every length up to ``every`` bytes and in the last 16, then one in seven.
    """
    ends = {*range(min(every, len(data))), *range(0, len(data), 7), *range(len(data))[-16:]}
    yield from (data[:size] for size in sorted(ends))
    yield data + b"\0"
    yield data + b"\0\0"
    for bit in (*range(min(every, 8 * len(data))), *range(every, 8 * len(data), 9)):
        copy = bytearray(data)
        copy[bit // 8] ^= 1 << bit % 8
        yield bytes(copy)


@pytest.mark.parametrize("name", ["triplets", "busy", "mixture", "spread 3000"])
def test_damaged_headers_are_refused_or_other_models(name):
    value = matrices()[name]
    model = tables_model(value, 256)
    header, first = model.header, model.encode(value[:256])
    for bad in damaged(header):
        model = outcome(row_coder.read, bad, value.shape[1])
        if not isinstance(model, str):
            assert model.header == bad
            outcome(model.decode, first, 256)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "tables") for name in ("triplets", "busy", "mixture", "spread 3000")),
        ("mixture", "mixed"),
    ],
)
def test_damaged_chunks_are_refused_or_other_rows(name, kind):
    value = matrices()[name][: 200 if kind == "tables" else 60]
    model = tables_model(value) if kind == "tables" else mixed_model(value)
    data = model.encode(value)
    for bad in damaged(data, 400 if kind == "tables" else 64):
        rows = outcome(model.decode, bad, len(value))
        if kind == "tables" or bad[:-1] != data[:-1]:  # several last bytes name the same interval
            assert isinstance(rows, str) or (rows != value).any()


@pytest.mark.parametrize("level", row_coder.LEVELS)
def test_wrong_row_counts_are_refused(level):
    value = draw(300, 4, 6)
    model = row_coder.fit(value, level)
    data = model.encode(value)
    for rows in (0, 1, 299, 301, 3000):
        with pytest.raises(ValueError, match="stream"):
            model.decode(data, rows)


@pytest.mark.parametrize("header", [b"", b"\0\0", b"\1", b"\3", b"\1" + b"\xff" * 30, bytes(9)])
def test_hostile_headers_are_refused(header):
    with pytest.raises(ValueError, match="stream"):
        row_coder.read(header, 3)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(39),
        bytes(40),
        b"\xff" * 60,
        b"\xff\xff\xff\xff\0\0\0\0" + bytes(32),
        b"\0\0\0\0\xff\xff\xff\x7f" + b"\0\0\1\0" * 8,
        bytes(8) + b"\0\0\1\0" * 7 + b"\xff\xff\0\0",
        b"\1\0\0\0\0\0\0\0\1" + b"\0\0\1\0" * 8,
    ],
)
def test_hostile_chunks_are_refused(data):
    model = row_coder.fit(draw(3000, 2, 3000), "fast")
    with pytest.raises(ValueError, match="stream"):
        model.decode(data, 100)
