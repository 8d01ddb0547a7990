"""Positions as an octree, for reading (FORMAT.md, parts 4 and 13); same bytes as the C coder.

Mode 1 is here, mode 2 in ``octree_sparse``.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise, product

import numpy as np
import numpy.typing as npt

from clgs.reference.codec import octree_sparse
from clgs.reference.codec.coding import (
    Coder,
    Curve,
    RangeDecoder,
    RangeEncoder,
    State,
    WideDecoder,
    WideEncoder,
    code_mixed,
)
from clgs.reference.codec.varint import read_varint, varint

LIMIT, SHIFT = 250, 15
HEADER = 14
MIRRORS = (4, 2, 1, 6, 5, 3, 7)
"""Outer cells of a child, by the axes (x 4, y 2, z 1) on which they lie beyond its parent."""

Cell = tuple[int, int, int]
Level = dict[Cell, int]
"""Cells of one level with their occupancy, in Morton order; bit c: child c = 4 x + 2 y + z."""


def encode(
    position: npt.NDArray[np.int32], origin: tuple[int, int, int] | None = None, mode: int = 2
) -> bytes:
    """The octree stream of ``position`` (N, 3) int32, unique, in Morton order, N >= 1.

    Morton order is relative to ``origin``, by default the per-axis minimum. ``mode`` is 2, or 1 as
    files of version 1 have it.
    """
    corner = np.array(position.min(axis=0) if origin is None else origin, np.int64)
    cells = [(int(x), int(y), int(z)) for x, y, z in position - corner]
    depth = max(max(cell) for cell in cells).bit_length()
    codes = [_morton(cell) for cell in cells]
    if any(first >= second for first, second in pairwise(codes)):
        raise ValueError("positions must be unique and in Morton order")
    raw = bytes([0, depth]) + corner.astype("<i4").tobytes()
    raw += b"".join(code.to_bytes(8, "little") for code in codes)
    if mode == 1:
        coder = RangeEncoder()
        _code_levels(coder, depth, cells)
        data = b"\1" + raw[1:HEADER] + coder.finish()
    else:
        wide = WideEncoder()
        octree_sparse.code_levels(wide, depth, cells)
        data = bytes([2, depth]) + b"".join(varint(int(c)) for c in corner) + wide.finish()
    return min(data, raw, key=len)


def decode(data: bytes, count: int) -> npt.NDArray[np.int32]:
    """``count`` positions (count, 3) int32 in Morton order.

    Raises:
        ValueError: the stream is damaged.
    """
    mode, depth = data[0], data[1]
    if mode == 2:
        axes, at = [], 2
        for _ in range(3):
            axis, at = read_varint(data, at)
            axes.append(axis)
        wide = WideDecoder(data[at:])
        cells = sorted(octree_sparse.code_levels(wide, depth, None, count), key=_morton)
        wide.finish()
    else:
        axes = np.frombuffer(data, "<i4", 3, offset=2).tolist()
        cells = _decode_older(data, count)
    if len(cells) != count:
        raise ValueError(f"{len(cells)} points instead of {count}")
    return (np.array(cells, np.int64) + np.array(axes, np.int64)).astype(np.int32)


def _decode_older(data: bytes, count: int) -> list[Cell]:
    """Cells of modes 0 and 1."""
    if data[0] == 0:
        codes = np.frombuffer(data, "<u8", count, offset=HEADER)
        return [_cell(int(code)) for code in codes]
    coder = RangeDecoder(data[HEADER:])
    cells = _code_levels(coder, data[1], None, count)
    coder.finish()
    return cells


def _code_levels(
    coder: Coder, depth: int, leaves: list[Cell] | None, count: int | None = None
) -> list[Cell]:
    """Code the levels from the root down; ``leaves`` are known to the encoder only."""
    model = _Model()
    cells: list[Cell] = [(0, 0, 0)]
    for height in range(depth, 0, -1):
        level: Level = dict.fromkeys(cells, 0)
        for leaf in leaves or ():
            x, y, z = (axis >> (height - 1) for axis in leaf)
            level[x >> 1, y >> 1, z >> 1] |= 1 << (4 * (x & 1) + 2 * (y & 1) + (z & 1))
        coded: set[Cell] = set()
        for cell in cells:
            level[cell] = model.code_node(coder, level, coded, cell, height)
            coded.add(cell)
        cells = [child for cell in cells for child in _children(cell, level[cell])]
        if count is not None and len(cells) > count:
            raise ValueError("the stream holds what no encoder writes")
    return cells


class _Model:
    """States, weights and curves; each comes into being when first used."""

    def __init__(self) -> None:
        self.face: dict[tuple[int, ...], State] = defaultdict(lambda: State(LIMIT))
        self.outer: dict[tuple[int, ...], State] = defaultdict(lambda: State(LIMIT))
        self.weights: dict[tuple[int, int], list[int]] = defaultdict(lambda: [32768, 32768])
        self.curves: dict[tuple[int, int], Curve] = defaultdict(Curve)

    def code_node(
        self, coder: Coder, level: Level, coded: set[Cell], cell: Cell, height: int
    ) -> int:
        """Code the occupancy of ``cell``: one decision a child, fewer where the last is sure."""
        occupancy, prefix = 0, 1
        kind = min(height, 4) - 1 if height <= 4 else 4 + (height > 7)
        for octant in range(8):
            if octant == 7 and occupancy == 0:
                return 128
            cells = tuple(_state(level, coded, cell, octant, m) for m in MIRRORS)
            bit = code_mixed(
                coder,
                level[cell] >> octant & 1,
                [
                    self.face[(kind, prefix, *cells[:3])],
                    self.outer[(*cells, occupancy.bit_count())],
                ],
                self.weights[kind, octant],
                SHIFT,
                self.curves[kind, prefix],
            )
            occupancy |= bit << octant
            prefix = prefix << 1 | bit
        return occupancy


def _state(level: Level, coded: set[Cell], cell: Cell, octant: int, mirror: int) -> int:
    """What is known of an outer cell: 0 absent, 1 not yet coded, 2 / 3 its child is empty / full.

    The child is the one that touches ``octant``.
    """
    steps = ((1 if octant >> a & 1 else -1) if mirror >> a & 1 else 0 for a in (2, 1, 0))
    x, y, z = (own + step for own, step in zip(cell, steps, strict=True))
    if (x, y, z) not in level:
        return 0
    if (x, y, z) not in coded:
        return 1
    return 2 + (level[x, y, z] >> (octant ^ mirror) & 1)


def _children(cell: Cell, occupancy: int) -> list[Cell]:
    x, y, z = (2 * axis for axis in cell)
    return [
        (x + i, y + j, z + k)
        for i, j, k in product((0, 1), repeat=3)
        if occupancy >> (4 * i + 2 * j + k) & 1
    ]


def _morton(cell: Cell) -> int:
    return sum((cell[a] >> b & 1) << (3 * b + 2 - a) for a in range(3) for b in range(21))


def _cell(code: int) -> Cell:
    x, y, z = (sum((code >> (3 * b + 2 - a) & 1) << b for b in range(21)) for a in range(3))
    return x, y, z
