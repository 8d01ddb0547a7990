"""Section CHNK: which bytes of the other sections belong to which anchors (FORMAT.md, part 11)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.container import ANCH, FEAT, OFFS, SCAL
from clgs.codec.meta import Grid

TAGS = (ANCH, OFFS, FEAT, SCAL)
"""The sections in chunks, in the order of the directory's columns."""

DEFAULT_CHUNK = 65_536
MIN_CHUNK, MAX_CHUNK = 64, 1 << 24
"""Anchors of a chunk, as the encoder takes them; a reader takes 1 and more."""

_HEAD = struct.Struct("<9I")
_ROW = np.dtype(
    [("least", "<i4", 3), ("greatest", "<i4", 3), ("length", "<u4", 4), ("crc", "<u4", 4)]
)


@dataclass(frozen=True)
class Part:
    """A run of bytes of a section, at byte ``offset`` from its start."""

    offset: int
    length: int
    crc: int


@dataclass(frozen=True)
class Directory:
    """What CHNK holds.

    chunk: anchors a chunk, the last has the rest; headers: for each of TAGS the part that all its
    chunks share; least, greatest (chunks, 3) int32: the corners of each chunk's positions;
    parts: for each of TAGS one part a chunk.
    """

    chunk: int
    headers: dict[str, Part]
    least: npt.NDArray[np.int32]
    greatest: npt.NDArray[np.int32]
    parts: dict[str, list[Part]]

    def __len__(self) -> int:
        return len(self.least)

    def length(self, tag: str) -> int:
        """Bytes of section ``tag``."""
        return self.headers[tag].length + sum(part.length for part in self.parts[tag])


def spans(anchors: int, chunk: int) -> list[slice]:
    """The rows of every chunk."""
    return [slice(at, min(at + chunk, anchors)) for at in range(0, anchors, chunk)]


def pack_directory(
    chunk: int,
    position: npt.NDArray[np.int32],
    headers: dict[str, bytes],
    streams: dict[str, list[bytes]],
) -> bytes:
    """Section CHNK of ``position`` (A, 3) int32 in Morton order, and the bytes of its chunks."""
    shared = [number for tag in TAGS for number in _measure(headers[tag])]
    rows = np.zeros(len(streams[ANCH]), _ROW)
    for index, span in enumerate(spans(len(position), chunk)):
        corners = position[span].min(axis=0), position[span].max(axis=0)
        length, crc = zip(*(_measure(streams[tag][index]) for tag in TAGS), strict=True)
        rows[index] = (*corners, length, crc)
    return _HEAD.pack(chunk, *shared) + rows.tobytes()


def _measure(data: bytes) -> tuple[int, int]:
    return len(data), _codec.crc32c(data)


def unpack_directory(data: bytes | memoryview, anchors: int, grid: Grid) -> Directory:
    """Read section CHNK of a file of ``anchors`` anchors on ``grid``.

    Raises:
        ValueError: wrong size, or corners outside of the grid.
    """
    if len(data) < _HEAD.size:
        raise ValueError(f"{len(data)} bytes, at least {_HEAD.size} are needed")
    chunk, *shared = _HEAD.unpack_from(data)
    if not 1 <= chunk <= MAX_CHUNK:
        raise ValueError(f"{chunk} anchors a chunk, 1 to {MAX_CHUNK} are possible")
    count = -(-anchors // chunk)
    if len(data) != _HEAD.size + count * _ROW.itemsize:
        raise ValueError(f"{len(data)} bytes do not describe {count} chunks")
    rows = np.frombuffer(data, _ROW, count, _HEAD.size)
    least, greatest = rows["least"].astype(np.int32), rows["greatest"].astype(np.int32)
    _check_corners(least, greatest, grid)
    headers, parts = {}, {}
    for column, tag in enumerate(TAGS):
        length, crc = shared[2 * column : 2 * column + 2]
        headers[tag] = Part(0, length, crc)
        parts[tag] = _parts(length, rows["length"][:, column], rows["crc"][:, column])
    return Directory(chunk, headers, least, greatest, parts)


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


def _parts(start: int, length: npt.NDArray[np.uint32], crc: npt.NDArray[np.uint32]) -> list[Part]:
    ends = start + np.cumsum(length, dtype=np.int64)
    columns: Sequence[list[int]] = ((ends - length).tolist(), length.tolist(), crc.tolist())
    return [Part(*values) for values in zip(*columns, strict=True)]


def make_grid(position: npt.NDArray[np.int32], level: str) -> Grid:
    """The smallest grid that holds ``position`` (A, 3) int32."""
    if len(position) == 0:
        return Grid((0, 0, 0), 0, level)
    x, y, z = map(int, position.min(axis=0))
    extent = position.max(axis=0).astype(np.int64) - (x, y, z)
    return Grid((x, y, z), int(extent.max()).bit_length(), level)
