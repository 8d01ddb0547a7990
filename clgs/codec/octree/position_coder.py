"""Anchor positions to bytes and back, and the Morton order that all sections share."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.errors import CodecError

MAX_DEPTH = 21
MAX_EXTENT = 1 << MAX_DEPTH
"""Positions span fewer cells than this on each axis: 3 x 21 bits fit a Morton code."""

SPARSE, BARE = 2, 3
"""First bytes of an octree: with its depth and corner, or without, for a reader that knows them.

A stream of plain Morton codes begins with 0.
"""

MAX_POINTS_PER_BYTE = 1 << 15
"""No octree stream holds more: a point costs a decision, a decision at least 1/22,711 byte."""


class PositionsError(CodecError):
    """Positions that no octree holds: too far apart if ``wide``, otherwise repeated.

    ``problem`` says so without a remedy, which depends on the source of the integers.
    """

    def __init__(self, problem: str, remedy: str, wide: bool) -> None:
        super().__init__(f"{problem}; {remedy}")
        self.problem = problem
        self.wide = wide


def corners(position: npt.NDArray[np.int32]) -> tuple[list[int], list[int]]:
    """Least and greatest coordinate of each axis of ``position`` (A, 3), A > 0.

    Axis by axis: NumPy takes thirty times as long for both rows of numbers at once.
    """
    columns = [position[:, axis] for axis in range(3)]
    return [int(one.min()) for one in columns], [int(one.max()) for one in columns]


def morton_codes(position: npt.NDArray[np.int32]) -> npt.NDArray[np.uint64]:
    """Morton codes (A,) of ``position`` (A, 3) int32 relative to its least corner, x highest.

    Raises:
        PositionsError: the extent reaches 2^21 on an axis.
    """
    code = np.empty(len(position), np.uint64)
    if len(position) == 0:
        return code
    low, high = corners(position)
    for axis in range(3):
        extent = high[axis] - low[axis] + 1
        if extent > MAX_EXTENT:
            problem = f"{'xyz'[axis]} spans {extent} integers, at most {MAX_EXTENT} fit"
            remedy = "round to larger steps, or leave out distant rows"
            raise PositionsError(f"position: {problem}", remedy, wide=True)
    _codec.morton_encode(np.ascontiguousarray(position, np.int32), code, *low)
    return code


def morton_order(position: npt.NDArray[np.int32]) -> npt.NDArray[np.intp]:
    """The permutation (A,) that sorts ``position`` (A, 3) int32 into Morton order.

    Raises:
        PositionsError: the extent reaches 2^21 on an axis, or rows are alike.
    """
    code = morton_codes(position)
    if ascends(code):
        return np.arange(len(code))
    order = np.argsort(code, kind="stable")
    repeats = np.flatnonzero(code[order][1:] == code[order][:-1])
    if len(repeats):
        first, second = map(int, order[repeats[0] : repeats[0] + 2])
        problem = f"rows {first} and {second} share cell {position[first].tolist()}, "
        problem += f"{len(repeats)} rows repeat others"
        remedy = "merge rows of the same cell"
        raise PositionsError(f"position: {problem}", remedy, wide=False)
    return order


def ascends(code: npt.NDArray[np.uint64]) -> bool:
    """Whether every code is above the one before."""
    return bool((code[1:] > code[:-1]).all())


def in_order(position: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """``position`` (A, 3) int32 in Morton order; itself if it is in order.

    Raises:
        PositionsError: as ``morton_order``.
    """
    order = morton_order(position)
    return position if (order[1:] > order[:-1]).all() else position[order]


def encode(position: npt.NDArray[np.int32], origin: tuple[int, int, int] | None = None) -> bytes:
    """The octree stream of ``position`` (A, 3) int32, unique and in Morton order.

    Codes are relative to ``origin``, which is at most 2^21 - 1 below any position; by default the
    per-axis minimum.

    Raises:
        ValueError: not unique, not in Morton order, or the extent reaches 2^21.
    """
    if len(position) == 0:
        return b""
    x, y, z = corners(position)[0] if origin is None else origin
    return _codec.octree_encode(np.ascontiguousarray(position, np.int32), x, y, z)


def decode(data: bytes | memoryview, count: int) -> npt.NDArray[np.int32]:
    """``count`` positions (count, 3) int32 in Morton order.

    Raises:
        ValueError: the stream is damaged, or holds another number of points.
    """
    if count > len(data) * MAX_POINTS_PER_BYTE:
        raise ValueError(f"{len(data)} bytes cannot hold {count} points")
    position = np.empty((count, 3), np.int32)
    if count > 0:
        _codec.octree_decode(data, position)
    elif len(data) > 0:
        raise ValueError("bytes follow the last symbol of the stream")
    return position


def encode_in(position: npt.NDArray[np.int32], corner: tuple[int, int, int]) -> bytes:
    """The stream of a cell of a larger octree, whose reader knows its corner and its depth.

    Raises:
        ValueError: as ``encode``.
    """
    data = encode(position, corner)
    if data[:1] != bytes([SPARSE]):
        return data
    return bytes([BARE]) + data[len(_head(corner, data[1])) :]


def decode_in(
    data: bytes | memoryview, count: int, corner: tuple[int, int, int], depth: int
) -> npt.NDArray[np.int32]:
    """``count`` positions (count, 3) int32 of a stream of ``encode_in``.

    Raises:
        ValueError: as ``decode``.
    """
    if data[:1] == bytes([BARE]):
        data = _head(corner, depth) + bytes(data[1:])
    return decode(data, count)


def _head(corner: tuple[int, int, int], depth: int) -> bytes:
    """What an octree begins with: its first byte, depth, corner as varints."""
    head = bytearray([SPARSE, depth])
    for number in corner:
        zigzag = 2 * number if number >= 0 else -2 * number - 1
        while zigzag >= 128:
            head.append(zigzag & 127 | 128)
            zigzag >>= 7
        head.append(zigzag)
    return bytes(head)
