"""Positions to bytes and back as octrees, their Morton order, and chunks that decode alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.errors import CodecError

MAX_DEPTH = 21
MAX_EXTENT = 1 << MAX_DEPTH
"""Positions span fewer cells than this on each axis: 3 x 21 bits fit a Morton code."""

SPARSE, BARE = 2, 3
"""The first byte of an octree: SPARSE if depth and corner follow, BARE if the reader knows them.

A stream of plain Morton codes begins with 0.
"""

COMPACT = 16_384
"""Smaller chunks are cut at cells, so that each can be read alone. Larger ones are for threads."""

MAX_POINTS_PER_BYTE = 1 << 15
"""An octree has at most this many points per byte, since a point takes at least 1/22,711 byte."""

Corner: TypeAlias = tuple[int, int, int]


class PositionsError(CodecError):
    """No octree holds these positions: they are too far apart if ``wide``, otherwise they repeat.

    ``problem`` is the message without the remedy, which depends on where the integers come from.
    """

    def __init__(self, problem: str, remedy: str, wide: bool) -> None:
        super().__init__(f"{problem}; {remedy}")
        self.problem = problem
        self.wide = wide


def bounds(position: npt.NDArray[np.int32]) -> tuple[Corner, Corner]:
    """Least and greatest coordinate of each axis of ``position`` (A, 3), A > 0.

    It goes axis by axis, which takes NumPy a thirtieth of the time of ``min(axis=0)``.
    """
    x, y, z = (position[:, axis] for axis in range(3))
    return ((int(x.min()), int(y.min()), int(z.min())), (int(x.max()), int(y.max()), int(z.max())))


def morton_codes(position: npt.NDArray[np.int32]) -> npt.NDArray[np.uint64]:
    """Morton codes (A,) of ``position`` (A, 3) int32 relative to its least corner, x highest.

    Raises:
        PositionsError: the extent reaches 2^21 on an axis.
    """
    code = np.empty(len(position), np.uint64)
    if len(position) == 0:
        return code
    low, high = bounds(position)
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


def encode(position: npt.NDArray[np.int32], origin: Corner | None = None) -> bytes:
    """The octree stream of ``position`` (A, 3) int32, unique and in Morton order.

    Codes are relative to ``origin``, which is at most 2^21 - 1 below any position; by default the
    per-axis minimum.

    Raises:
        ValueError: not unique, not in Morton order, or the extent reaches 2^21.
    """
    if len(position) == 0:
        return b""
    corner = bounds(position)[0] if origin is None else origin
    return _codec.octree_encode(np.ascontiguousarray(position, np.int32), *corner)


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


def encode_in(position: npt.NDArray[np.int32], corner: Corner) -> bytes:
    """The stream of a cell of a larger octree, whose reader knows its corner and its depth.

    Raises:
        ValueError: as ``encode``.
    """
    data = encode(position, corner)
    if data[:1] != bytes([SPARSE]):
        return data
    return bytes([BARE]) + data[len(_head(corner, data[1])) :]


def decode_in(
    data: bytes | memoryview, count: int, corner: Corner, depth: int
) -> npt.NDArray[np.int32]:
    """``count`` positions (count, 3) int32 of a stream of ``encode_in``.

    Raises:
        ValueError: as ``decode``.
    """
    if data[:1] == bytes([BARE]):
        data = _head(corner, depth) + bytes(data[1:])
    return decode(data, count)


def _head(corner: Corner, depth: int) -> bytes:
    """The first bytes of an octree: its kind, its depth and its corner as varints."""
    head = bytearray([SPARSE, depth])
    for number in corner:
        zigzag = 2 * number if number >= 0 else -2 * number - 1
        while zigzag >= 128:
            head.append(zigzag & 127 | 128)
            zigzag >>= 7
        head.append(zigzag)
    return bytes(head)


def runs(count: int, most: int) -> list[slice]:
    """Slices of ``count`` rows with ``most`` rows each; the last one has the rest."""
    return [slice(at, min(at + most, count)) for at in range(0, count, most)]


def cut(position: npt.NDArray[np.int32], most: int, part: slice = slice(None)) -> list[slice]:
    """Chunks of at most ``most`` points of ``part`` of a cloud (A, 3) int32, in Morton order there.

    Codes are relative to the least corner of the whole cloud.

    If ``most`` is below COMPACT, a chunk is a cell of the octree, or some neighbouring children of
    one cell. These fill less space than any run of points, and so they meet fewer boxes.
    """
    first, end, _ = part.indices(len(position))
    if most >= COMPACT:
        return [slice(first + run.start, first + run.stop) for run in runs(end - first, most)]
    code = morton_codes(position)
    chunks: list[slice] = []
    todo = [(first, end, MAX_DEPTH)] if first < end else []
    while todo:
        start, stop, level = todo.pop()
        if stop - start <= most:
            chunks.append(slice(start, stop))
            continue
        # the first point of each child of the cell, then the end of the last child
        below = 3 * (level - 1)
        cell = int(code[start]) >> below + 3 << 3
        codes = np.array([cell + child << below for child in range(1, 8)], np.uint64)
        edges = {start, *(start + np.searchsorted(code[start:stop], codes)).tolist(), stop}
        joined = _join(position, sorted(edges), most)
        todo += [(low, high, level - 1) for low, high in reversed(joined)]
    return chunks


def _join(position: npt.NDArray[np.int32], edges: list[int], most: int) -> list[tuple[int, int]]:
    """Children joined to as few runs of neighbours as ``most`` points per run allow.

    Of all ways to do this, the one whose runs have the least sum of points times the edges of
    their boxes.
    """
    points = position[edges[0] : edges[-1]]
    first = np.array(edges[:-1]) - edges[0]
    low, high = np.minimum.reduceat(points, first), np.maximum.reduceat(points, first)
    best = [(0, 0, 0)]  # up to each edge: number of runs, the sum, the edge before
    for end in range(1, len(edges)):
        ways = []
        for begin in range(end):
            count = edges[end] - edges[begin]
            if count <= most or begin == end - 1:
                span = high[begin:end].max(axis=0).astype(np.int64) - low[begin:end].min(axis=0)
                parts, total, _ = best[begin]
                ways.append((parts + 1, total + count * int(span.sum()), begin))
        best.append(min(ways))
    joined, end = [], len(edges) - 1
    while end > 0:
        joined.append((edges[best[end][2]], edges[end]))
        end = best[end][2]
    return joined[::-1]


def cell_corners(position: npt.NDArray[np.int32], chunks: list[slice]) -> list[Corner]:
    """The origin of each chunk's octree: the corner of the smallest cell that holds the chunk.

    The cell is one of the octree of the whole. Relative to its corner the points of a chunk keep
    their Morton order; relative to their own minimum they would not.
    """
    if not chunks:
        return []
    first = [chunk.start for chunk in chunks]
    least = np.minimum.reduceat(position, first).tolist()
    greatest = np.maximum.reduceat(position, first).tolist()
    origin = bounds(position)[0]
    return [enclosing_cell(*box, origin)[0] for box in zip(least, greatest, strict=True)]


def enclosing_cell(
    least: Sequence[int], greatest: Sequence[int], origin: Corner
) -> tuple[Corner, int]:
    """Corner and levels of the smallest cell that holds a box, in an octree from ``origin``."""
    ends = [(low - o, high - o) for low, high, o in zip(least, greatest, origin, strict=True)]
    levels = max((low ^ high).bit_length() for low, high in ends)
    x, y, z = (o + (low >> levels << levels) for (low, _), o in zip(ends, origin, strict=True))
    return (x, y, z), levels


def batches(chunks: list[slice]) -> list[range]:
    """Indices of neighbouring chunks, joined until they are worth a task of their own."""
    found: list[range] = []
    first = 0
    for index, chunk in enumerate(chunks):
        if chunk.stop - chunks[first].start >= COMPACT or index == len(chunks) - 1:
            found.append(range(first, index + 1))
            first = index + 1
    return found
