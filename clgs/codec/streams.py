"""Arrays of positions, and of attributes, to bytes and back, each on its own, outside of any file.

The code is that of .clgs files (codec_c/FORMAT.md on arrays).

Positions whose differences share a factor on some axis are divided by it first, as each level of
an octree costs bits: q = c + (p - c) / f on each axis, with c the least p.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.arguments import check_choice
from clgs.codec import octree, row_coder
from clgs.codec.meta import LEVELS
from clgs.errors import CodecError
from clgs.machine import workers

POSITIONS, LATTICE, ATTRIBUTES = b"\x8bCP\x02", b"\x8bCP\x03", b"\x8bCA\x02"
"""Signatures: of positions as they are, of positions divided by their factors, of attributes."""

POINTS, ROWS = 131_072, 65_536
"""Rows per chunk of positions and of attributes."""

MAX_CHANNELS = row_coder.MAX_CHANNELS
MAX_OUTPUT = 1 << 32
"""Bytes that one stream may decode to."""

SAMPLE = 64
"""Points that are tried first: mostly they show that there is no common factor."""

_POSITIONS_HEAD = struct.Struct("<4sI")
_LATTICE_HEAD = struct.Struct("<4sIIII")
_ATTRIBUTES_HEAD = struct.Struct("<4sIHI")
_HEADS = {POSITIONS: _POSITIONS_HEAD, LATTICE: _LATTICE_HEAD, ATTRIBUTES: _ATTRIBUTES_HEAD}
_CRC = struct.Struct("<I")


def encode_positions(positions: npt.ArrayLike, threads: int | None = None) -> bytes:
    """Unique integer positions as bytes, lossless but for the order of the rows.

    Args:
        positions: (N, 3) of any integer dtype and memory layout, in any order; every number in the
            range of int32, on each axis less than 2^21 from the least to the greatest. N = 0 is
            allowed.
        threads: at most this many, by default one per processor; no byte depends on it.

    Raises:
        TypeError: not an array of integers.
        CodecError: wrong shape, masked, out of range, too far apart, or rows repeat (how many).
    """
    position = octree.in_order(_check_positions(positions))
    plain = _encode_octrees(_POSITIONS_HEAD.pack(POSITIONS, len(position)), position, threads)
    factors = common_factors(position) if len(position) else (1, 1, 1)
    if max(factors) == 1:
        return plain
    least = np.array(octree.bounds(position)[0])
    divided = octree.in_order((least + (position - least) // factors).astype(np.int32))
    head = _LATTICE_HEAD.pack(LATTICE, len(position), *factors)
    return min(plain, _encode_octrees(head, divided, threads), key=len)


def _encode_octrees(head: bytes, position: npt.NDArray[np.int32], threads: int | None) -> bytes:
    with workers(threads) as pool:
        parts = octree.runs(len(position), POINTS)
        clouds = [position[part] for part in parts]
        streams = list(pool.map(octree.encode, clouds, octree.cell_corners(position, parts)))
    return _seal(head, b"", streams)


def decode_positions(
    data: bytes | bytearray | memoryview, threads: int | None = None
) -> npt.NDArray[np.int32]:
    """The positions (N, 3) int32 that ``encode_positions`` was given, in Morton order.

    Raises:
        CodecError: the bytes are damaged, or of another kind.
    """
    body = _unseal(data, POSITIONS, LATTICE)
    head = _HEADS[bytes(body[:4])]
    _, count, *factors = head.unpack_from(body)
    if factors and not (count > 0 and 1 <= min(factors) <= max(factors) <= octree.MAX_EXTENT):
        raise _damage(_POSITIONS_HEAD.size, f"factors {factors} of {count} points")
    position = _decode_octrees(body, head.size, count, threads)
    try:
        if not octree.ascends(octree.morton_codes(position)):
            raise ValueError("the chunks are not in Morton order")
        if not factors:
            return position
        corner = np.array(octree.bounds(position)[0])
        grown = corner + (position - corner) * np.array(factors)
        if grown.max() > np.iinfo(np.int32).max:
            raise ValueError("the lattice leaves the range of int32")
        return octree.in_order(grown.astype(np.int32))
    except octree.PositionsError as error:
        raise _damage(head.size, error.problem) from error
    except ValueError as error:
        raise _damage(head.size, str(error)) from error


def _decode_octrees(
    body: memoryview, at: int, count: int, threads: int | None
) -> npt.NDArray[np.int32]:
    """``count`` positions (count, 3) int32, chunk after chunk; their lengths are at ``at``."""
    parts = octree.runs(count, POINTS)
    _, streams = _split(body, at, 0, len(parts))
    for part, (start, stream) in zip(parts, streams, strict=True):
        if part.stop - part.start > len(stream) * octree.MAX_POINTS_PER_BYTE:
            raise _damage(start, f"{len(stream)} bytes cannot hold {part.stop - part.start} points")

    def decode_chunk(part: slice, stream: tuple[int, memoryview]) -> npt.NDArray[np.int32]:
        try:
            return octree.decode(stream[1], part.stop - part.start)
        except ValueError as error:
            raise _damage(stream[0], str(error)) from error

    with workers(threads) as pool:
        chunks = list(pool.map(decode_chunk, parts, streams))
    return np.concatenate([np.empty((0, 3), np.int32), *chunks])


def declared_shape(data: bytes | bytearray | memoryview) -> tuple[int, int]:
    """Rows and channels that a stream of positions or attributes declares.

    To be compared with what is expected before anything is decoded. (-1, -1) for other bytes.
    """
    head = bytes(data[: _ATTRIBUTES_HEAD.size])
    if head[:4] in (POSITIONS, LATTICE) and len(head) >= _POSITIONS_HEAD.size:
        return _POSITIONS_HEAD.unpack_from(head)[1], 3
    if head[:4] == ATTRIBUTES and len(head) == _ATTRIBUTES_HEAD.size:
        return _ATTRIBUTES_HEAD.unpack(head)[1:3]
    return -1, -1


def encode_attributes(
    values: npt.ArrayLike, level: str = "default", threads: int | None = None
) -> bytes:
    """Rows of integers as bytes, lossless; rows in Morton order of their positions cost least.

    Args:
        values: (N, channels) of any integer dtype and memory layout, 1 to 256 channels, every
            number in the range of int32. N = 0 is allowed.
        level: "fast", "default", "max" or "paper": time against bytes, as `clgs encode --level`.
        threads: at most this many, by default one per processor; no byte depends on it.

    Raises:
        TypeError: not an array of integers, or a level that is no string.
        CodecError: wrong shape, masked, or out of range.
        UsageError: no such level.
    """
    check_choice("level", level, LEVELS)
    rows = check_integers("values", values)
    if not 1 <= rows.shape[1] <= MAX_CHANNELS:
        raise CodecError(f"values: {rows.shape[1]} channels, 1 to {MAX_CHANNELS} are possible")
    if rows.nbytes > MAX_OUTPUT:
        raise CodecError(f"values: {rows.nbytes} bytes as int32, at most {MAX_OUTPUT} fit")
    model = row_coder.fit(rows, level, ROWS)
    with workers(threads) as pool:
        chunks = [rows[part] for part in octree.runs(len(rows), ROWS)]
        streams = list(pool.map(model.encode, chunks))
    head = _ATTRIBUTES_HEAD.pack(ATTRIBUTES, *rows.shape, len(model.header))
    return _seal(head, model.header, streams)


def decode_attributes(
    data: bytes | bytearray | memoryview, threads: int | None = None
) -> npt.NDArray[np.int32]:
    """The rows (N, channels) int32 that ``encode_attributes`` was given.

    Raises:
        CodecError: the bytes are damaged, or of another kind.
    """
    body = _unseal(data, ATTRIBUTES)
    _, count, channels, shared = _ATTRIBUTES_HEAD.unpack_from(body)
    if not 1 <= channels <= MAX_CHANNELS or 4 * count * channels > MAX_OUTPUT:
        raise _damage(4, f"{count} rows of {channels} channels are out of range")
    parts = octree.runs(count, ROWS)
    header, streams = _split(body, _ATTRIBUTES_HEAD.size, shared, len(parts))
    try:
        model = row_coder.read(header, channels)
    except ValueError as error:
        raise _damage(_ATTRIBUTES_HEAD.size + 4 * len(parts), str(error)) from error
    rows = np.empty((count, channels), np.int32)

    def decode_chunk(part: slice, stream: tuple[int, memoryview]) -> None:
        try:
            rows[part] = model.decode(stream[1], part.stop - part.start)
        except ValueError as error:
            raise _damage(stream[0], str(error)) from error

    with workers(threads) as pool:
        list(pool.map(decode_chunk, parts, streams))
    return rows


def morton_order(positions: npt.ArrayLike) -> npt.NDArray[np.intp]:
    """The permutation (N,) that sorts ``positions`` into Morton order.

    ``positions[morton_order(positions)]`` is what ``decode_positions`` returns; attributes sorted
    alike belong to it row by row. Morton order is that of the interleaved bits of the distances
    from the per-axis minimum, x highest.

    Raises:
        TypeError, CodecError: as of ``encode_positions``.
    """
    return octree.morton_order(_check_positions(positions))


def _check_positions(positions: npt.ArrayLike) -> npt.NDArray[np.int32]:
    position = check_integers("positions", positions)
    if position.shape[1] != 3:
        raise CodecError(f"positions: shape is {position.shape}, (N, 3) is needed")
    return position


def check_integers(name: str, values: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """``values`` (N, columns) as contiguous int32.

    Raises:
        TypeError: not an array of integers.
        CodecError: rows of several lengths, not two axes, a masked element, or out of range.
    """
    if np.ma.is_masked(values):
        hidden = np.count_nonzero(np.ma.getmask(values))
        raise CodecError(f"{name}: {hidden} elements are masked; fill them or leave out the rows")
    try:
        array = np.asarray(values)
    except ValueError:
        raise CodecError(f"{name}: rows of several lengths; (N, columns) is needed") from None
    if array.size == 0 and isinstance(values, list):
        raise CodecError(f"{name}: an empty list has no columns; np.empty((0, 3), int) has three")
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name}: dtype is {array.dtype}, integers are needed; round floats first")
    if array.ndim != 2:
        raise CodecError(f"{name}: shape is {array.shape}, two axes are needed")
    if array.size and not np.can_cast(array.dtype, np.int32):
        low, high = int(array.min()), int(array.max())
        if low < -(2**31) or high >= 2**31:
            raise CodecError(f"{name}: {low} to {high} is outside of int32; round to larger steps")
    return np.ascontiguousarray(array, np.int32)


def common_factors(position: npt.NDArray[np.int32]) -> list[int]:
    """The greatest common factor, at least 1, of all differences on each axis of (N, 3), N > 0."""
    factors = []
    for column in position.T:
        factor = 0
        for part in (column[:SAMPLE], column):
            if factor != 1:
                factor = int(np.gcd.reduce(part.astype(np.int64) - int(part[0])))
        factors.append(max(factor, 1))
    return factors


def _seal(head: bytes, header: bytes, streams: list[bytes]) -> bytes:
    """Head, lengths of the streams (u32 each), header, streams, checksum."""
    lengths = struct.pack(f"<{len(streams)}I", *map(len, streams))
    body = b"".join([head, lengths, header, *streams])
    return body + _CRC.pack(_codec.crc32c(body))


def _unseal(data: bytes | bytearray | memoryview, *signatures: bytes) -> memoryview:
    """All but the checksum, which is verified; at least a head of one of these signatures."""
    view = memoryview(data)
    view = view.cast("B") if view.c_contiguous else memoryview(view.tobytes())
    signature = bytes(view[:4])
    if signature not in signatures:
        kind = "attributes" if ATTRIBUTES in signatures else "positions"
        raise CodecError(f"stream at byte 0: these are no {kind}; encode them again")
    if len(view) < _HEADS[signature].size + _CRC.size:
        raise _damage(0, f"{len(view)} bytes are too few")
    body = view[: -_CRC.size]
    if _codec.crc32c(body) != _CRC.unpack(view[-_CRC.size :])[0]:
        raise _damage(len(body), "checksum differs")
    return body


def _split(
    body: memoryview, at: int, shared: int, count: int
) -> tuple[memoryview, list[tuple[int, memoryview]]]:
    """Header of ``shared`` bytes and the (offset, bytes) of ``count`` streams."""
    start = at + 4 * count
    if start + shared > len(body):
        raise _damage(at, f"{len(body)} bytes cannot hold {count} chunks")
    lengths = struct.unpack_from(f"<{count}I", body, at)
    if start + shared + sum(lengths) != len(body):
        raise _damage(at, "lengths of the chunks do not add up")
    streams, end = [], start + shared
    for length in lengths:
        streams.append((end, body[end : end + length]))
        end += length
    return body[start : start + shared], streams


def _damage(at: int, what: str) -> CodecError:
    return CodecError(f"stream at byte {at}: {what}; it is damaged; copy or encode it again")
