"""The library: integer arrays of every kind to bytes and back, without a scene or a device."""

from __future__ import annotations

import struct
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from clgs import codec
from clgs.codec import octree, streams
from clgs.codec.scene_encoder import encode
from clgs.errors import CodecError, UsageError
from tests.codec.samples import cloud, in_order, sealed
from tests.codec.scenes import random_scene

INTEGERS = ["i1", "u1", "<i2", ">i2", "<u2", "<i4", ">i4", "<u4", ">u4", "<i8", ">i8", "<u8", ">u8"]
LEVELS = ("fast", "default", "max", "paper")


@pytest.mark.parametrize("dtype", INTEGERS)
def test_every_integer_dtype(dtype):
    values = np.arange(60).reshape(20, 3).astype(dtype)
    np.testing.assert_array_equal(
        decoded := codec.decode_attributes(codec.encode_attributes(values)), values
    )
    assert decoded.dtype == np.int32
    assert codec.encode_attributes(values) == codec.encode_attributes(values.astype(np.int64))
    decoded = codec.decode_positions(codec.encode_positions(values))
    assert decoded.dtype == np.int32
    np.testing.assert_array_equal(decoded, in_order(values))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("shape", [(0, 1), (0, 3), (0, 256), (1, 1), (1, 256), (7, 5), (300, 30)])
def test_shapes_and_levels(level, shape):
    rng = np.random.default_rng(4)
    for values in (rng.integers(-3, 4, shape), rng.integers(-(2**31), 2**31, shape)):
        data = codec.encode_attributes(values, level)
        decoded = codec.decode_attributes(data)
        assert decoded.shape == shape
        np.testing.assert_array_equal(decoded, values)


def test_layouts():
    values = np.random.default_rng(1).integers(-9, 9, (50, 6))
    data = codec.encode_attributes(values)
    read_only = values.copy()
    read_only.setflags(write=False)
    wide = np.repeat(np.repeat(values, 2, axis=0), 2, axis=1)[::2, ::2]
    for same in (np.asfortranarray(values), read_only, wide, values[::-1][::-1], values.tolist()):
        assert codec.encode_attributes(same) == data
    assert codec.decode_attributes(data).flags.writeable
    for view in (bytearray(data), memoryview(data)):
        np.testing.assert_array_equal(codec.decode_attributes(view), values)


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
@pytest.mark.parametrize("origin", [-(2**31), -1, 0, 2**31 - 2**21])
def test_positions_in_any_order_at_any_origin(count, origin):
    positions = cloud(count) + origin
    decoded = codec.decode_positions(codec.encode_positions(positions))
    assert decoded.shape == (len(positions), 3)
    np.testing.assert_array_equal(decoded, in_order(positions))
    order = np.random.default_rng(2).permutation(len(positions))
    assert codec.encode_positions(positions[order]) == codec.encode_positions(positions)


@settings(max_examples=40, deadline=None)
@given(
    npst.arrays(np.int32, st.tuples(st.integers(0, 40), st.just(3)), elements=st.integers(0, 30)),
    st.integers(0, 16),
)
def test_positions_of_any_shape(positions, shift):
    positions = np.unique(positions, axis=0) << shift
    decoded = codec.decode_positions(codec.encode_positions(positions))
    np.testing.assert_array_equal(decoded, in_order(positions))


@pytest.mark.slow
def test_large_arrays_are_cut_and_threads_change_nothing():
    positions = cloud(300_000, extent=2**12)
    assert len(positions) > 2 * streams.POINTS
    data = codec.encode_positions(positions, threads=1)
    assert codec.encode_positions(positions, threads=3) == data
    np.testing.assert_array_equal(codec.decode_positions(data), in_order(positions))
    values = np.random.default_rng(3).integers(-2, 3, (150_000, 4))
    data = codec.encode_attributes(values, threads=1)
    assert codec.encode_attributes(values, threads=3) == data
    np.testing.assert_array_equal(codec.decode_attributes(data), values)


def test_calls_from_many_threads():
    values = [np.random.default_rng(i).integers(-9, 9, (500, 6)) for i in range(16)]
    with ThreadPoolExecutor(8) as pool:
        data = list(pool.map(codec.encode_attributes, values))
        for decoded, value in zip(pool.map(codec.decode_attributes, data), values, strict=True):
            np.testing.assert_array_equal(decoded, value)


def test_repeated_positions_are_refused_with_their_count():
    positions = np.concatenate([cloud(20), cloud(20)[:7], cloud(20)[:2]])
    for function in (codec.encode_positions, codec.morton_order):
        with pytest.raises(
            CodecError, match=r"^position: rows \d+ and \d+ share .*, 9 rows repeat"
        ):
            function(positions)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_extents(axis):
    positions = np.zeros((2, 3), np.int64)
    positions[1, axis] = 2**21 - 1
    codec.encode_positions(positions)
    positions[1, axis] = 2**21
    said = f"^position: {'xyz'[axis]} spans 2097153 integers, at most 2097152 fit; round to larger"
    for function in (codec.encode_positions, codec.morton_order):
        with pytest.raises(CodecError, match=said):
            function(positions)


def test_chunks_that_lie_too_far_apart_are_damage(monkeypatch):
    monkeypatch.setattr(streams, "POINTS", 1)
    data = bytearray(codec.encode_positions([[0, 0, 0], [2**21 - 1, 0, 0]]))
    far = octree.encode(np.array([[2**21, 0, 0]], np.int32))
    start = len(data) - 4 - len(octree.encode(np.array([[2**21 - 1, 0, 0]], np.int32)))
    body = data[:12] + struct.pack("<I", len(far)) + data[16:start] + far
    with pytest.raises(CodecError, match=r"^stream at byte 8: position: x spans .*; it is damaged"):
        codec.decode_positions(sealed(bytes(body)))


def test_lists_of_rows_of_several_lengths_are_refused():
    for function in (codec.encode_positions, codec.encode_attributes, codec.morton_order):
        with pytest.raises(CodecError, match=r"^\w+: rows of several lengths; \(N, columns\) is"):
            function([[1, 2, 3], [4, 5]])


def test_masked_elements_are_refused():
    """A mask that hides nothing is fine."""
    values = cloud(20)
    masked = np.ma.array(values, mask=np.zeros(values.shape, bool))
    for function in (codec.encode_positions, codec.encode_attributes, codec.morton_order):
        np.testing.assert_array_equal(
            np.frombuffer(function(masked), np.uint8), np.frombuffer(function(values), np.uint8)
        )
        hidden = masked.copy()
        hidden[3, 1:] = np.ma.masked
        with pytest.raises(CodecError, match=r"^\w+: 2 elements are masked; fill them"):
            function(hidden)


@pytest.mark.parametrize(
    "level", [np.array(["fast", "max"]), np.arange(99), ["fast"], None, 1, b"fast"]
)
def test_levels_are_strings(level):
    with pytest.raises(TypeError, match=r"^level: .{1,60}; a string is needed$"):
        codec.encode_attributes(np.zeros((2, 2), int), level)
    for options in ({"level": level}, {"mlp": level}):
        with pytest.raises(TypeError, match=r"^(level|mlp): .{1,60}; a string is needed$"):
            encode(random_scene(np.random.default_rng(1), 2), **options)
    for options in ({"chunk": np.arange(99.0)}, {"threads": np.arange(99.0)}, {"layers": True}):
        with pytest.raises(
            TypeError, match=r"^(chunk|threads|layers): .{1,60}; an integer is needed$"
        ):
            encode(random_scene(np.random.default_rng(1), 2), **options)


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1, 2**63 - 1, 2**64 - 1])
def test_numbers_outside_of_int32_are_refused(value):
    array = np.array([[0, 0, value]], np.uint64 if value >= 2**63 else np.int64)
    for function in (codec.encode_positions, codec.encode_attributes, codec.morton_order):
        with pytest.raises(CodecError, match=f"{value}.* outside of int32"):
            function(array)


def test_other_types_and_shapes_are_refused():
    functions = (codec.encode_positions, codec.encode_attributes, codec.morton_order)
    for function in functions:
        for dtype in (float, bool, complex, object, "U3", "M8[s]"):
            with pytest.raises(TypeError, match="integers are needed"):
                function(np.zeros((2, 3), dtype))
        for shape in ((), (3,), (2, 3, 1)):
            with pytest.raises(CodecError, match="two axes"):
                function(np.zeros(shape, int))
        for empty in ([], [[]]):
            with pytest.raises(CodecError, match="an empty list has no columns"):
                function(empty)
    for columns in (0, 2, 4):
        for function in (codec.encode_positions, codec.morton_order):
            with pytest.raises(CodecError, match=r"\(N, 3\) is needed"):
                function(np.zeros((2, columns), int))
    for channels in (0, 257):
        with pytest.raises(CodecError, match=f"{channels} channels"):
            codec.encode_attributes(np.zeros((2, channels), int))
    with pytest.raises(UsageError, match="level: 'best'"):
        codec.encode_attributes(np.zeros((2, 2), int), "best")


@pytest.mark.parametrize("threads", [1.5, 1.0, "2", [1]])
def test_threads_are_integers(threads):
    for function, argument in (
        (codec.encode_positions, np.zeros((1, 3), int)),
        (codec.encode_attributes, np.zeros((1, 3), int)),
        *SMALL,
    ):
        with pytest.raises(TypeError, match=r"^threads: .*; an integer is needed"):
            function(argument, threads=threads)
        function(argument, threads=np.int64(2))


SMALL = (
    (codec.decode_positions, codec.encode_positions(cloud(60, extent=30))),
    (codec.decode_attributes, codec.encode_attributes(cloud(60, extent=30) - 15)),
)


@pytest.mark.parametrize(("decode", "data"), SMALL)
def test_every_flip_and_cut_is_a_codec_error(decode, data):
    for at in range(len(data)):
        with pytest.raises(CodecError, match=r"^stream at byte \d+: "):
            decode(data[:at])
        for bit in range(8):
            with pytest.raises(CodecError, match=r"^stream at byte \d+: "):
                decode(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])
    for more in range(1, 17):
        with pytest.raises(CodecError, match="checksum"):
            decode(data + b"\0" * more)


@pytest.mark.parametrize(("decode", "data"), SMALL)
def test_damage_with_a_right_checksum_is_refused_or_decodes(decode, data, rng):
    for _ in range(200):
        body = bytearray(data[:-4])
        for _ in range(rng.integers(1, 5)):
            body[rng.integers(4, len(body))] = rng.integers(256)
        try:
            decoded = decode(sealed(bytes(body)))
        except CodecError as error:
            assert str(error).startswith("stream at byte ")  # noqa: PT017 - or no error at all
        else:
            assert decoded.dtype == np.int32


@pytest.mark.parametrize("count", [1, 2**20, 2**31, 2**32 - 1])
def test_declared_counts_are_bounded_by_the_bytes_that_follow(count):
    with pytest.raises(CodecError, match="stream at byte"):
        codec.decode_positions(sealed(struct.pack("<4sI", streams.POSITIONS, count)))
    for channels in (0, 1, 256, 257, 2**16 - 1):
        head = struct.pack("<4sIHI", streams.ATTRIBUTES, count, channels, 0)
        with pytest.raises(CodecError, match="stream at byte"):
            codec.decode_attributes(sealed(head))
    with pytest.raises(CodecError, match="stream at byte"):
        codec.decode_positions(
            sealed(struct.pack("<4sII", streams.POSITIONS, 2**20, 14)) + bytes(14)
        )


def test_one_kind_is_not_the_other():
    for kind, decode, data in (
        ("positions", codec.decode_positions, SMALL[1][1]),
        ("attributes", codec.decode_attributes, SMALL[0][1]),
    ):
        for wrong in (data, b""):
            with pytest.raises(CodecError, match=f"^stream at byte 0: these are no {kind}; encode"):
                decode(wrong)


def test_it_needs_no_opencl():
    program = "import sys; sys.modules['pyopencl'] = None; import clgs.codec as c; "
    program += "print(c.decode_positions(c.encode_positions([[1, 2, 3]])).tolist())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[[1, 2, 3]]", done.stderr


def test_bytes_may_lie_apart():
    data = codec.encode_positions(np.eye(3, dtype=int))
    apart = memoryview(bytes(2 * len(data))).cast("B").tolist()
    apart[::2] = data
    assert np.array_equal(codec.decode_positions(memoryview(bytes(apart))[::2]), np.eye(3)[::-1])
