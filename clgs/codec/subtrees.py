"""Cut a cloud in Morton order into parts that decode alone: runs of it, or cells of its octree."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import octree
from clgs.codec.octree import MAX_DEPTH

COMPACT = 16_384
"""Parts below this size follow the cells: they are there to be read alone, not for threads."""


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
    code = octree.morton_codes(position)
    parts: list[slice] = []
    todo = [(0, len(position), MAX_DEPTH)] if len(position) else []
    while todo:
        start, stop, level = todo.pop()
        if stop - start <= most:
            parts.append(slice(start, stop))
        else:
            todo += reversed(_children(code, start, stop, level, most))
    return parts


def _children(
    code: npt.NDArray[np.uint64], start: int, stop: int, level: int, most: int
) -> list[tuple[int, int, int]]:
    """(start, stop, level) of the children of a cell, small neighbours joined."""
    below = 3 * (level - 1)
    first = int(code[start]) >> below + 3 << 3
    bounds = np.array([first + child << below for child in range(1, 8)], np.uint64)
    edges = [start, *(start + np.searchsorted(code[start:stop], bounds)).tolist(), stop]
    joined: list[tuple[int, int, int]] = []
    for low, high in pairwise(edges):
        if joined and high - joined[-1][0] <= most:
            joined[-1] = (joined[-1][0], high, level - 1)
        elif high > low:
            joined.append((low, high, level - 1))
    return joined


def corners(position: npt.NDArray[np.int32], parts: list[slice]) -> list[tuple[int, int, int]]:
    """The origin of each part's octree: a corner of the least cell of the whole that holds it.

    Relative to it, the points of the part keep their order; relative to their own minimum they
    would not.
    """
    if not parts:
        return []
    low = position.min(axis=0)
    ends = np.array([[part.start, part.stop - 1] for part in parts]).ravel()
    code = np.empty(len(ends), np.uint64)
    _codec.morton_encode(np.ascontiguousarray(position[ends]), code, *map(int, low))
    found = []
    for first, last in code.reshape(-1, 2).tolist():
        levels = -(-(first ^ last).bit_length() // 3)
        found.append(_corner(first >> 3 * levels << 3 * levels, low))
    return found


def _corner(code: int, origin: npt.NDArray[np.int32]) -> tuple[int, int, int]:
    """The position of a Morton code relative to ``origin``."""
    x, y, z = (
        int(origin[axis]) + sum((code >> 3 * bit + 2 - axis & 1) << bit for bit in range(MAX_DEPTH))
        for axis in range(3)
    )
    return x, y, z


def batches(parts: list[slice]) -> list[range]:
    """Numbers of neighbouring parts that together are worth a thread's turn."""
    found: list[range] = []
    first = 0
    for index, part in enumerate(parts):
        if part.stop - parts[first].start >= COMPACT or index == len(parts) - 1:
            found.append(range(first, index + 1))
            first = index + 1
    return found
