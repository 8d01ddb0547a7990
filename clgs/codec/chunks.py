"""Section CHNK: which bytes of the other sections belong to which anchors (FORMAT.md, part 11)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import runlength
from clgs.codec.container import ANCH, FEAT, OFFS, SCAL
from clgs.codec.meta import Grid

TAGS = (ANCH, OFFS, FEAT, SCAL)
"""The sections in chunks, in the order of the directory's columns."""

DEFAULT_CHUNK = 65_536
MIN_CHUNK, MAX_CHUNK = 16, 1 << 20
"""Anchors of a chunk, at most."""

COLUMNS = 11
"""Of a chunk: anchors, least x y z, greatest x y z, bytes in each of TAGS."""

_HEAD = struct.Struct("<10I")

Table = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Part:
    """A run of bytes of a section, at byte ``offset`` from its start."""

    offset: int
    length: int


@dataclass(frozen=True)
class Directory:
    """What CHNK holds.

    chunk: anchors a chunk, at most; spans: the rows of every chunk; headers: for each of TAGS the
    part that all its chunks share, with its CRC; least, greatest (chunks, 3) int32: the corners of
    each chunk's positions; parts: for each of TAGS one part a chunk; position_crc: of every chunk's
    part of ANCH; rows_crc: of its parts of the other sections, one after the other.
    """

    chunk: int
    spans: list[slice]
    headers: dict[str, tuple[Part, int]]
    least: npt.NDArray[np.int32]
    greatest: npt.NDArray[np.int32]
    parts: dict[str, list[Part]]
    position_crc: list[int]
    rows_crc: list[int]

    def length(self, tag: str) -> int:
        """Bytes of section ``tag``."""
        return self.headers[tag][0].length + sum(part.length for part in self.parts[tag])


def pack_directory(
    chunk: int,
    position: npt.NDArray[np.int32],
    spans: list[slice],
    headers: dict[str, bytes],
    streams: dict[str, list[bytes]],
) -> bytes:
    """Section CHNK of ``position`` (A, 3) int32 in Morton order, and the bytes of its chunks."""
    table = np.empty((len(spans), COLUMNS), np.int32)
    table[:, 0] = [span.stop - span.start for span in spans]
    for row, span in zip(table, spans, strict=True):
        row[1:4], row[4:7] = position[span].min(axis=0), position[span].max(axis=0)
    for column, tag in enumerate(TAGS):
        table[:, 7 + column] = [len(stream) for stream in streams[tag]]
    crcs = [_codec.crc32c(stream) for stream in streams[ANCH]]
    rows = zip(*(streams[tag] for tag in TAGS[1:]), strict=True)
    crcs += [_codec.crc32c(b"".join(parts)) for parts in rows]
    shared = [number for tag in TAGS for number in measure(headers[tag])]
    return pack_table(chunk, shared, crcs, table)


def measure(data: bytes) -> tuple[int, int]:
    """Length and CRC."""
    return len(data), _codec.crc32c(data)


def pack_table(chunk: int, shared: list[int], crcs: list[int], table: Table) -> bytes:
    """CHNK of the columns (chunks, COLUMNS); ``shared``: length and CRC of the four headers."""
    relative = table.copy()
    relative[1:, 1:4] -= table[:-1, 1:4]
    relative[:, 4:7] -= table[:, 1:4]
    head = _HEAD.pack(chunk, len(table), *shared)
    return head + struct.pack(f"<{len(crcs)}I", *crcs) + runlength.encode(relative)


def unpack_table(data: bytes | memoryview) -> tuple[int, list[int], list[int], Table]:
    """What ``pack_table`` was given.

    Raises:
        ValueError: the section is damaged.
    """
    if len(data) < _HEAD.size:
        raise ValueError(f"{len(data)} bytes, at least {_HEAD.size} are needed")
    chunk, count, *shared = _HEAD.unpack_from(data)
    table_start = _HEAD.size + 8 * count
    if len(data) < table_start:
        raise ValueError(f"{len(data)} bytes cannot hold {count} chunks")
    crcs = list(struct.unpack_from(f"<{2 * count}I", data, _HEAD.size))
    wide = runlength.decode(data[table_start:], count, COLUMNS).astype(np.int64)
    wide[:, 1:4] = np.cumsum(wide[:, 1:4], axis=0)
    wide[:, 4:7] += wide[:, 1:4]
    table = wide.astype(np.int32)
    if (table != wide).any():
        raise ValueError("corners of a chunk are outside of int32")
    return chunk, shared, crcs, table


def unpack_directory(data: bytes | memoryview, anchors: int, grid: Grid) -> Directory:
    """Read section CHNK of a file of ``anchors`` anchors on ``grid``.

    Raises:
        ValueError: the section is damaged, or does not fit the counts and the grid.
    """
    chunk, shared, crcs, table = unpack_table(data)
    counts = table[:, 0]
    if not 1 <= chunk <= MAX_CHUNK or (counts < 1).any() or (counts > chunk).any():
        raise ValueError(f"numbers of anchors a chunk are not in [1, {chunk}]")
    stops = np.cumsum(counts, dtype=np.int64).tolist()
    if (stops[-1] if stops else 0) != anchors:
        raise ValueError(f"chunks do not hold {anchors} anchors")
    if (table[:, 7:] < 0).any():
        raise ValueError("a chunk has a negative length")
    least, greatest = table[:, 1:4], table[:, 4:7]
    _check_corners(least, greatest, grid)
    headers, parts = {}, {}
    for column, tag in enumerate(TAGS):
        length, crc = shared[2 * column : 2 * column + 2]
        headers[tag] = Part(0, length), crc
        ends = length + np.cumsum(table[:, 7 + column], dtype=np.int64)
        starts = (ends - table[:, 7 + column]).tolist()
        parts[tag] = [
            Part(*part) for part in zip(starts, table[:, 7 + column].tolist(), strict=True)
        ]
    spans = [slice(start, stop) for start, stop in zip([0, *stops], stops, strict=False)]
    half = len(table)
    return Directory(chunk, spans, headers, least, greatest, parts, crcs[:half], crcs[half:])


def _check_corners(
    least: npt.NDArray[np.int32], greatest: npt.NDArray[np.int32], grid: Grid
) -> None:
    """Raise ValueError unless the grid is the smallest that holds all corners."""
    origin = np.array(grid.origin, np.int64)
    if len(least) == 0:
        if grid.depth > 0 or origin.any():
            raise ValueError("a grid without anchors")
        return
    extent = (greatest - origin).max()
    if (least > greatest).any() or (least.min(axis=0) != origin).any():
        raise ValueError("corners of a chunk do not fit the origin")
    if int(extent).bit_length() != grid.depth:
        raise ValueError(f"corners of a chunk do not fit depth {grid.depth}")


def make_grid(position: npt.NDArray[np.int32], level: str) -> Grid:
    """The smallest grid that holds ``position`` (A, 3) int32."""
    if len(position) == 0:
        return Grid((0, 0, 0), 0, level)
    x, y, z = map(int, position.min(axis=0))
    extent = position.max(axis=0).astype(np.int64) - (x, y, z)
    return Grid((x, y, z), int(extent.max()).bit_length(), level)
