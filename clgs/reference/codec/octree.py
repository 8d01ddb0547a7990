"""Positions as an octree, for reading (FORMAT.md on ANCH); same bytes as the C coder."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from clgs.reference.codec import octree_sparse
from clgs.reference.codec.coding import WideDecoder, WideEncoder
from clgs.reference.codec.varint import read_varint, varint

RAW, OCTREE = 0, 2
"""First byte of a stream: Morton codes as they are, or an octree."""
RAW_HEADER = 14

Cell = tuple[int, int, int]


def encode(position: npt.NDArray[np.int32], origin: tuple[int, int, int] | None = None) -> bytes:
    """The stream of ``position`` (N, 3) int32, unique, in Morton order, N >= 1.

    Morton order is relative to ``origin``, by default the per-axis minimum.
    """
    corner = np.array(position.min(axis=0) if origin is None else origin, np.int64)
    cells = [(int(x), int(y), int(z)) for x, y, z in position - corner]
    depth = max(max(cell) for cell in cells).bit_length()
    codes = [_morton(cell) for cell in cells]
    if any(first >= second for first, second in pairwise(codes)):
        raise ValueError("positions must be unique and in Morton order")
    raw = bytes([RAW, depth]) + corner.astype("<i4").tobytes()
    raw += b"".join(code.to_bytes(8, "little") for code in codes)
    coder = WideEncoder()
    octree_sparse.code_levels(coder, depth, cells)
    coded = bytes([OCTREE, depth]) + b"".join(varint(int(c)) for c in corner) + coder.finish()
    return min(coded, raw, key=len)


def decode(data: bytes, count: int) -> npt.NDArray[np.int32]:
    """``count`` positions (count, 3) int32 in Morton order.

    Raises:
        ValueError: the stream is damaged.
    """
    if data[0] == RAW:
        axes = np.frombuffer(data, "<i4", 3, offset=2).tolist()
        codes = np.frombuffer(data, "<u8", count, offset=RAW_HEADER)
        cells = [_cell(int(code)) for code in codes]
    elif data[0] == OCTREE:
        axes, at = [], 2
        for _ in range(3):
            axis, at = read_varint(data, at)
            axes.append(axis)
        coder = WideDecoder(data[at:])
        cells = sorted(octree_sparse.code_levels(coder, data[1], None, count), key=_morton)
        coder.finish()
    else:
        raise ValueError("the stream holds what no encoder writes")
    if len(cells) != count:
        raise ValueError(f"{len(cells)} points instead of {count}")
    return (np.array(cells, np.int64) + np.array(axes, np.int64)).astype(np.int32)


def _morton(cell: Cell) -> int:
    return sum((cell[a] >> b & 1) << (3 * b + 2 - a) for a in range(3) for b in range(21))


def _cell(code: int) -> Cell:
    x, y, z = (sum((code >> (3 * b + 2 - a) & 1) << b for b in range(21)) for a in range(3))
    return x, y, z
