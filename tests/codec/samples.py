"""Points, rows and models for the codec's tests, drawn by integer arithmetic alone."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import strategies as st

from clgs import _codec
from clgs.codec import attribute_search, morton_order, row_coder
from clgs.codec.octree import runs

INT32 = st.integers(-(2**31), 2**31 - 1)


def draw(rows: int, channels: int, spread: int) -> np.ndarray:
    """Peaked integers (rows, channels), by integer arithmetic alone."""
    state = np.arange(1, rows * channels + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    state ^= state >> np.uint64(29)
    state *= np.uint64(0xBF58476D1CE4E5B9)
    first, second = ((state >> np.uint64(s) & np.uint64(0xFFFF)).astype(np.int64) for s in (16, 40))
    value = ((first - 32768) * second * spread >> 31) * (first % 3 > 0)
    return value.astype(np.int32).reshape(rows, channels)


def cloud(count: int, seed: int = 0, extent: int = 2**21) -> np.ndarray:
    """About ``count`` points, in any order."""
    rng = np.random.default_rng(seed)
    return rng.permutation(np.unique(rng.integers(0, extent, (count, 3)), axis=0))


def in_order(positions: np.ndarray) -> np.ndarray:
    return positions[morton_order(positions)]


def sealed(body: bytes) -> bytes:
    """A stream with its checksum."""
    return body + struct.pack("<I", _codec.crc32c(body))


def clouds() -> dict[str, np.ndarray]:
    grid = np.argwhere(np.ones((5, 6, 7), bool))
    x, y = np.indices((20, 20))
    far = np.array([[-(2**31)] * 3, [-(2**31) + 2**21 - 1] * 3])
    found = {
        "no point": np.empty((0, 3), np.int32),
        "one point": np.array([[2**31 - 1, -(2**31), 0]]),
        "two far points": far,
        "cube": np.argwhere(np.ones((5, 5, 5), bool)),
        "line": np.arange(100)[:, None] * np.array([[7, 0, -3]]),
        "scattered": np.unique(draw(60, 3, 2**20), axis=0),
        "dense": grid[draw(len(grid), 1, 9)[:, 0] != 0],
        "surface": np.stack([x, y, (x**2 + y) // 9], -1).reshape(-1, 3),
        "diagonal": np.arange(0, 2**21, 2**21 // 60)[:, None] * [1, 1, 1],
        "chain": np.array([[0, 0, 0], [0, 0, 1], [2**20, 5, 9], [2**20 + 1, 5, 9]]),
        "thinned": 3 * grid[draw(len(grid), 1, 9)[:, 0] >= 0],
        "clusters": np.unique(draw(200, 3, 4) + 5000 * (np.arange(200) % 3)[:, None], axis=0),
    }
    for depth in range(1, 22):
        ends = [[0, 0, 0], [1, 0, 0], [2**depth - 1, 5 % 2**depth, 0]]
        inside = draw(40, 3, 2**31 - 1).astype(np.int64) % 2**depth
        found[f"depth {depth}"] = np.unique(ends, axis=0)
        found[f"many of depth {depth}"] = np.unique([*ends, *inside.tolist()], axis=0)
    return found


def matrices() -> dict[str, np.ndarray]:
    """Rows with enough structure for every feature of a model."""
    walk = np.cumsum(draw(400, 3, 9), axis=0)
    loud = 1 << np.abs(draw(16, 1, 31)).repeat(50, axis=0) % 5
    on = draw(400, 2, 9) != 0
    found = {f"spread {n}": draw(300, 4, n) for n in (1, 3, 60, 3000, 2**22, 2**31 - 1)}
    found |= {
        "triplets": draw(400, 6, 6) * np.repeat(on, 3, axis=1),
        "busy": draw(800, 5, 3) * loud,
        "mixture": np.column_stack([walk, walk.sum(axis=1) + draw(400, 1, 3)[:, 0], -walk[:, 1]]),
        "wide walk": np.cumsum(draw(400, 3, 2**22), axis=0, dtype=np.int32),
        "shifted": draw(300, 4, 6) + 2**30,
        "smooth": np.arange(120).reshape(40, 3) ** 2 // 40,
        "constant": np.full((300, 2), -77),
        "few rows": draw(5, 3, 6),
        "extremes": np.tile([[-(2**31)], [2**31 - 1], [0], [1]], (5, 3)),
    }
    return {name: value.astype(np.int32) for name, value in found.items()}


def encode_run_lengths(rows: np.ndarray) -> bytes:
    return _codec.runlength_encode(np.ascontiguousarray(rows, np.int32), rows.shape[1])


def decode_run_lengths(data: bytes, count: int, channels: int) -> np.ndarray:
    rows = np.empty((count, channels), np.int32)
    _codec.runlength_decode(data, rows, channels)
    return rows


def encode_paper(rows: np.ndarray) -> bytes:
    return row_coder.RowModel(rows.shape[1], row_coder.PAPER).encode(rows)


def decode_paper(data: bytes, count: int, channels: int) -> np.ndarray:
    return row_coder.RowModel(channels, row_coder.PAPER).decode(data, count)


def tables_model(value: np.ndarray, chunk: int = row_coder.CHUNK) -> row_coder.RowModel:
    """The model of level ``default`` if no other coder is shorter."""
    model, _ = attribute_search.fit(
        attribute_search.RowChunks(value, runs(len(value), chunk)), search=True
    )
    return row_coder.table_model(model)


def mixed_model(value: np.ndarray) -> row_coder.RowModel:
    """The model of level ``max``, with every channel but the first mixed."""
    model = tables_model(value).tables.copy()
    mixed = attribute_search.mix_all(model, attribute_search.RowSample(value))
    mixed[:1] = model[:1]
    return row_coder.table_model(mixed)
