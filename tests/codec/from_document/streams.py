"""Part 10: arrays without a scene."""

from __future__ import annotations

import numpy as np

from tests.codec.from_document.attributes import Attributes
from tests.codec.from_document.common import ByteReader, check, crc32c, in_int32, morton_code
from tests.codec.from_document.octree import decode_octree

POSITIONS = bytes.fromhex("8B435002")
LATTICE = bytes.fromhex("8B435003")
ATTRIBUTES = bytes.fromhex("8B434102")
POINTS_PER_CHUNK = 131072
ROWS_PER_CHUNK = 65536


def _open(data: bytes, what: str) -> tuple[bytes, ByteReader]:
    """The signature, and a reader of the bytes between it and the CRC."""
    check(len(data) >= 8, f"{what}: cut")
    check(crc32c(data[:-4]) == int.from_bytes(data[-4:], "little"), f"{what}: CRC differs")
    return data[:4], ByteReader(data[4:-4], what)


def _chunk_lengths(n: int, most: int) -> list[int]:
    """Rows of the chunks."""
    return [min(most, n - at) for at in range(0, n, most)]


def peek_shape(data: bytes) -> tuple[int, int]:
    """Rows and columns that a stream says it has, without decoding it."""
    if data[:4] in (POSITIONS, LATTICE):
        return int.from_bytes(data[4:8], "little"), 3
    check(data[:4] == ATTRIBUTES, "stream: unknown signature")
    return int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:10], "little")


def _check_order(points: list[list[int]], what: str) -> None:
    """Refuse points that are not in Morton order, or span too much."""
    if not points:
        return
    least = [min(axis) for axis in zip(*points, strict=True)]
    extent = max(
        max(axis) - low for axis, low in zip(zip(*points, strict=True), least, strict=True)
    )
    check(extent < 2**21, f"{what}: more than 2^21 cells")
    last = -1
    for point in points:
        code = morton_code(*(v - low for v, low in zip(point, least, strict=True)))
        check(code > last, f"{what}: not in Morton order")
        last = code


def decode_positions(data: bytes, what: str = "positions") -> np.ndarray:
    """N x 3 int32."""
    signature, reader = _open(data, what)
    check(signature in (POSITIONS, LATTICE), f"{what}: unknown signature")
    n = reader.number("I")
    factors = (1, 1, 1)
    if signature == LATTICE:
        check(n > 0, f"{what}: a lattice without points")
        factors = reader.fields("3I")
        check(all(1 <= f <= 2**21 for f in factors), f"{what}: factor out of range")
    counts = _chunk_lengths(n, POINTS_PER_CHUNK)
    lengths = reader.fields(f"{len(counts)}I")
    check(sum(lengths) == reader.left, f"{what}: lengths do not add up")
    points: list[list[int]] = []
    for number, (count, length) in enumerate(zip(counts, lengths, strict=True)):
        points += decode_octree(reader.take(length), count, f"{what} chunk {number}")
    _check_order(points, what)
    if signature == LATTICE:
        least = [min(axis) for axis in zip(*points, strict=True)]
        points = [
            [c + f * (q - c) for c, f, q in zip(least, factors, p, strict=True)] for p in points
        ]
        check(all(in_int32(v) for p in points for v in p), f"{what}: outside of int32")
        spans = [max(axis) - min(axis) for axis in zip(*points, strict=True)]
        check(max(spans) < 2**21, f"{what}: more than 2^21 cells")
        points.sort(key=lambda p: morton_code(*(v - c for v, c in zip(p, least, strict=True))))
    return np.array(points, np.int32).reshape(n, 3)


def decode_attributes(data: bytes, what: str = "attributes") -> np.ndarray:
    """N x C int32."""
    signature, reader = _open(data, what)
    check(signature == ATTRIBUTES, f"{what}: unknown signature")
    n, channels, header_length = reader.fields("IHI")
    check(1 <= channels <= 256, f"{what}: {channels} channels")
    check(4 * n * channels <= 2**32, f"{what}: too large")
    counts = _chunk_lengths(n, ROWS_PER_CHUNK)
    lengths = reader.fields(f"{len(counts)}I")
    check(header_length + sum(lengths) == reader.left, f"{what}: lengths do not add up")
    decoder = Attributes(reader.take(header_length), channels, what)
    chunks = [
        decoder.decode(reader.take(length), count, number)
        for number, (count, length) in enumerate(zip(counts, lengths, strict=True))
    ]
    return np.concatenate(chunks) if chunks else np.empty((0, channels), np.int32)
