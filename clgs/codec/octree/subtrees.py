"""Cut a cloud in Morton order into parts that decode alone: runs of it, or cells of its octree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from clgs.codec.octree import position_coder
from clgs.codec.octree.position_coder import MAX_DEPTH

COMPACT = 16_384
"""Points: smaller parts follow the cells, as they serve to be read alone, not for threads."""


def runs(count: int, most: int) -> list[slice]:
    """``count`` rows in parts of ``most``; the last has the rest."""
    return [slice(at, min(at + most, count)) for at in range(0, count, most)]


def cut(position: npt.NDArray[np.int32], most: int) -> list[slice]:
    """Parts of at most ``most`` points of a cloud (A, 3) int32 in Morton order.

    Below COMPACT, a part is a cell of the octree or neighbouring children of one, which fill less
    space than any run of points and so meet fewer boxes.
    """
    if most >= COMPACT:
        return runs(len(position), most)
    code = position_coder.morton_codes(position)
    parts: list[slice] = []
    todo = [(0, len(position), MAX_DEPTH)] if len(position) else []
    while todo:
        start, stop, level = todo.pop()
        if stop - start <= most:
            parts.append(slice(start, stop))
            continue
        edges = _children(code, start, stop, level)
        joined = _join(position, edges, most)
        todo += [(low, high, level - 1) for low, high in reversed(joined)]
    return parts


def _children(code: npt.NDArray[np.uint64], start: int, stop: int, level: int) -> list[int]:
    """First points of the children of a cell, and the end of the last one."""
    below = 3 * (level - 1)
    first = int(code[start]) >> below + 3 << 3
    bounds = np.array([first + child << below for child in range(1, 8)], np.uint64)
    edges = {start, *(start + np.searchsorted(code[start:stop], bounds)).tolist(), stop}
    return sorted(edges)


def _join(position: npt.NDArray[np.int32], edges: list[int], most: int) -> list[tuple[int, int]]:
    """Neighbouring children joined up to ``most`` points, to the fewest parts.

    Of these, the parts with the least sum of points times edges of their boxes.
    """
    points = position[edges[0] : edges[-1]]
    first = np.array(edges[:-1]) - edges[0]
    low, high = np.minimum.reduceat(points, first), np.maximum.reduceat(points, first)
    best = [(0, 0, 0)]  # up to each edge: parts, the sum, and the edge before
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


Corner: TypeAlias = tuple[int, int, int]


def corners(position: npt.NDArray[np.int32], parts: list[slice]) -> list[Corner]:
    """The origin of each part's octree: a corner of the least cell of the whole that holds it.

    Relative to it, the points of the part keep their order; relative to their own minimum they
    would not.
    """
    if not parts:
        return []
    first = [part.start for part in parts]
    least = np.minimum.reduceat(position, first).tolist()
    greatest = np.maximum.reduceat(position, first).tolist()
    x, y, z = position_coder.corners(position)[0]
    return [cell(low, high, (x, y, z))[0] for low, high in zip(least, greatest, strict=True)]


def cell(least: Sequence[int], greatest: Sequence[int], origin: Corner) -> tuple[Corner, int]:
    """Corner and levels of the least octree cell that holds a box, in an octree from ``origin``."""
    ends = [(low - o, high - o) for low, high, o in zip(least, greatest, origin, strict=True)]
    levels = max((low ^ high).bit_length() for low, high in ends)
    x, y, z = (o + (low >> levels << levels) for (low, _), o in zip(ends, origin, strict=True))
    return (x, y, z), levels


def batches(parts: list[slice]) -> list[range]:
    """Indices of neighbouring parts, joined until they are worth a task of their own."""
    found: list[range] = []
    first = 0
    for index, part in enumerate(parts):
        if part.stop - parts[first].start >= COMPACT or index == len(parts) - 1:
            found.append(range(first, index + 1))
            first = index + 1
    return found
