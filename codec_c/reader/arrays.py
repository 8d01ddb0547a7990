"""Positions and attributes as bytes of their own: part 10 of FORMAT.md."""

from __future__ import annotations

import numpy as np

from .attributes import Attributes
from .coding import ByteReader, check, crc32c, in_int32, morton_code
from .octree import decode_octree

POSITIONS, LATTICE = bytes.fromhex("8B435002"), bytes.fromhex("8B435003")
ATTRIBUTES = bytes.fromhex("8B434102")
POINTS_PER_CHUNK, ROWS_PER_CHUNK = 131072, 65536

Corner = list[int]


def check_order(points: list[list[int]], origin: tuple[int, ...] | Corner, last: int = -1) -> int:
    """Refuse points that are not in Morton order, after the code `last`; the code of the last."""
    for point in points:
        code = morton_code(*(v - o for v, o in zip(point, origin, strict=True)))
        check(code > last, "points are not in Morton order")
        last = code
    return last


def _open_stream(data: bytes) -> tuple[bytes, ByteReader]:
    """The signature of a stream, and a reader of the bytes between it and the CRC (part 10)."""
    check(len(data) >= 8, "a stream is cut")
    check(crc32c(data[:-4]) == int.from_bytes(data[-4:], "little"), "the CRC of a stream differs")
    return data[:4], ByteReader(data[4:-4])


def _chunks(reader: ByteReader, n: int, most: int, header: int = 0) -> list[tuple[int, int]]:
    """Rows and bytes of the chunks of a stream of n rows."""
    counts = [min(most, n - at) for at in range(0, n, most)]
    lengths = reader.fields(f"{len(counts)}I")
    check(header + sum(lengths) == reader.left, "the lengths of the chunks do not add up")
    return list(zip(counts, lengths, strict=True))


def decode_positions(data: bytes) -> np.ndarray:
    """The positions of a stream (part 10), (N, 3) int32."""
    signature, reader = _open_stream(data)
    check(signature in (POSITIONS, LATTICE), "not a stream of positions")
    (n,) = reader.fields("I")
    factors = reader.fields("3I") if signature == LATTICE else (1, 1, 1)
    check(all(1 <= f <= 2**21 for f in factors), "a factor is out of range")
    check(n > 0 or signature == POSITIONS, "a lattice without points")
    points: list[list[int]] = []
    for count, length in _chunks(reader, n, POINTS_PER_CHUNK):
        points += decode_octree(reader.take(length), count)
    if points:
        least = [min(axis) for axis in zip(*points, strict=True)]
        _check_extent(points)
        check_order(points, least)
        points = [
            [c + f * (v - c) for c, f, v in zip(least, factors, point, strict=True)]
            for point in points
        ]
        check(all(in_int32(v) for point in points for v in point), "a point outside of int32")
        _check_extent(points)
        points.sort(key=lambda p: morton_code(*(v - c for v, c in zip(p, least, strict=True))))
    return np.array(points, np.int32).reshape(n, 3)


def _check_extent(points: list[list[int]]) -> None:
    """Refuse points that span 2^21 cells or more."""
    spans = [max(axis) - min(axis) for axis in zip(*points, strict=True)]
    check(max(spans) < 2**21, "points span more than 2^21 cells")


def decode_attributes(data: bytes) -> np.ndarray:
    """The rows of a stream of attributes (part 10), (N, channels) int32."""
    signature, reader = _open_stream(data)
    check(signature == ATTRIBUTES, "not a stream of attributes")
    n, channels, header = reader.fields("IHI")
    check(1 <= channels <= 256 and 4 * n * channels <= 2**32, f"{n} rows of {channels} channels")
    chunks = _chunks(reader, n, ROWS_PER_CHUNK, header)
    decoder = Attributes(reader.take(header), channels)
    parts = [decoder.decode(reader.take(length), count) for count, length in chunks]
    return np.concatenate([np.empty((0, channels), np.int32), *parts])


def declared_shape(data: bytes) -> tuple[int, int]:
    """Rows and columns that a stream declares, before it is decoded."""
    columns = int.from_bytes(data[8:10], "little") if data[:4] == ATTRIBUTES else 3
    return int.from_bytes(data[4:8], "little"), columns
