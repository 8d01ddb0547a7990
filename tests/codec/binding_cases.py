"""Seeded calls of the codec's binding and library: damaged streams, and arrays of every kind."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np

from clgs import _codec
from clgs.codec import (
    decode_attributes,
    decode_positions,
    encode_attributes,
    encode_positions,
    morton_order,
)
from clgs.codec.attribute_model import CHANNEL, empty_model
from clgs.codec.meta import LEVELS
from clgs.errors import CodecError

Stream = tuple[Callable[[bytes], object], bytes]
DTYPES = ("i1", "u1", "<i2", ">i2", "<u2", ">u2", "<i4", ">i4", "<u4", ">u4", "<i8", ">i8", "<u8")


@cache
def streams() -> list[Stream]:
    """Functions of the binding, each with a stream that it decodes into an array of its own."""
    rng = np.random.default_rng(3)
    value = np.rint(rng.laplace(0, 2, (40, 3))).astype(np.int32)
    value[7:30] = 0
    points = np.unique(rng.integers(0, 9, (60, 3)), axis=0).astype(np.int32)
    points = points[morton_order(points)]
    word = np.rint(rng.normal(0, 40, (12, 10))).astype(np.float32).view(np.uint32)
    matrix = np.array([[12, 10]], np.uint32)
    return [
        (partial(_octree, len(points)), _codec.octree_encode(points, *map(int, points.min(0)))),
        (partial(_rows, _codec.runlength_decode, 40, 3), _codec.runlength_encode(value, 3)),
        (partial(_rows, _codec.paper_decode, 40, 3), _codec.paper_encode(value, 3)),
        (partial(_planes, word.size), _codec.planes_encode(word)),
        (partial(_weights, matrix), _codec.weights_encode(word, matrix)),
        (_model, b"\3" + _codec.attributes_header(empty_model(1))),
    ]


def _refused(function: Callable[..., object], *arguments: object) -> None:
    """Call the binding, whose errors are ValueErrors; the library makes CodecErrors of them."""
    try:
        function(*arguments)
    except ValueError as error:
        raise CodecError(str(error)) from error


def _octree(count: int, data: bytes) -> None:
    _refused(_codec.octree_decode, data, np.empty((count, 3), np.int32))


def _rows(function: Callable[..., object], rows: int, channels: int, data: bytes) -> None:
    _refused(function, data, np.empty((rows, channels), np.int32), channels)


def _planes(count: int, data: bytes) -> None:
    _refused(_codec.planes_decode, data, np.empty(count, np.uint32))


def _weights(matrix: np.ndarray, data: bytes) -> None:
    _refused(_codec.weights_decode, data, np.empty(120, np.uint32), matrix)


def _model(data: bytes) -> None:
    """The header of attributes, after a byte that says what else the caller's model holds."""
    model = np.zeros(1, CHANNEL)
    _refused(_codec.attributes_read, data[1:], model)
    raw = model.view(np.uint8)
    for byte in data[:1]:  # a model that no header describes: every function checks it
        raw[byte * 31 % raw.size] ^= byte
    chunk = np.zeros((9, 1), np.int32)
    _refused(_codec.attributes_decode, model, data, chunk, None)


def there_and_back(rng: np.random.Generator) -> None:
    """Any array of integers: as it was when decoded, or refused for the reason it gives."""
    rows, channels = int(rng.integers(0, 40)), int(rng.integers(1, 6))
    dtype = np.dtype(DTYPES[rng.integers(len(DTYPES))])
    bits = int(rng.integers(1, 8 * dtype.itemsize + 1))
    limits = np.iinfo(dtype)
    low = max(limits.min, -(2 ** (bits - 1)))
    high = min(limits.max, 2**bits - 1)
    value = rng.integers(low, high, (2 * rows, 2 * channels), dtype.newbyteorder("="), True)
    value = value.astype(dtype)[:: rng.choice((1, 2, -1)), :: rng.choice((1, 2, -2))]
    if rng.random() < 0.3:
        value = np.asfortranarray(value)
    fits = value.size == 0 or (int(value.min()) >= -(2**31) and int(value.max()) < 2**31)
    try:
        data = encode_attributes(value, LEVELS[rng.integers(len(LEVELS))], 1)
    except CodecError:
        assert not fits
        return
    assert fits
    np.testing.assert_array_equal(decode_attributes(data, 1), value)


def points_there_and_back(rng: np.random.Generator) -> None:
    """Points in any order at any origin: sorted when decoded; refused if they repeat."""
    count, bits = int(rng.integers(0, 60)), int(rng.integers(1, 23))
    origin = rng.integers(-(2**31), 2**31 - 2**bits, 3)
    points = origin + rng.integers(0, 2**bits, (count, 3))
    extent = np.ptp(points, axis=0) if count else np.zeros(3)
    good = len(np.unique(points, axis=0)) == count and bool((extent < 2**21).all())
    try:
        data = encode_positions(points, 1)
    except CodecError:
        assert not good
        return
    assert good
    np.testing.assert_array_equal(decode_positions(data, 1), points[morton_order(points)])
