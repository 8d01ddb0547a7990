"""Section CHNK: which bytes of the other sections belong to which anchors (codec_c/FORMAT.md).

Chunks are listed in groups, and the groups in a head, so that a reader of a part of the scene
reads only the lists that it needs.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.attributes import runlength
from clgs.codec.container.meta import Grid
from clgs.codec.container.section_table import ANCH, FEAT, OFFS, SCAL
from clgs.codec.octree import position_coder

TAGS = (ANCH, OFFS, FEAT, SCAL)
"""The sections in chunks, in the order of the directory's columns."""

DEFAULT_CHUNK = 65_536
MIN_CHUNK, MAX_CHUNK = 16, 1 << 20
"""Anchors per chunk, at most."""

GROUP = 64
"""Chunks per group; the last group has the rest."""

COLUMNS = 11
"""Per chunk or group: anchors, least x y z, greatest x y z, bytes in each of TAGS."""

_HEAD = struct.Struct("<11I")
HEAD_SIZE = _HEAD.size + 4
"""Bytes of CHNK that tell how long the rest of its head is."""

Table = npt.NDArray[np.int32]
Wide = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """A run of bytes of a section, at byte ``offset`` from its start."""

    offset: int
    length: int


@dataclass(frozen=True)
class Head:
    """What CHNK says of the whole.

    chunk: anchors per chunk, at most; count: number of chunks; headers: for each of TAGS the part
    that all its chunks share, with its CRC; groups (groups, COLUMNS); places: of every group its
    part of CHNK, with its CRC; size: bytes of CHNK.
    """

    chunk: int
    count: int
    headers: dict[str, tuple[Part, int]]
    groups: Wide
    places: list[tuple[Part, int]]
    size: int

    def length(self, tag: str) -> int:
        """Bytes of section ``tag``."""
        return self.headers[tag][0].length + int(self.groups[:, 7 + TAGS.index(tag)].sum())

    def starts(self) -> Wide:
        """The first anchor of every group, and its first byte in each of TAGS: (groups, 5)."""
        first = [0, *(self.headers[tag][0].length for tag in TAGS)]
        return _starts(self.groups, np.array(first, np.int64))


@dataclass(frozen=True)
class Chunk:
    """Neighbouring anchors: which they are, their corners, and their part of each of TAGS.

    ``position_crc``: of the part of ANCH; ``rows_crc``: of the others, one after the other.
    """

    number: int
    span: slice
    least: tuple[int, int, int]
    greatest: tuple[int, int, int]
    parts: dict[str, Part]
    position_crc: int
    rows_crc: int


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
    if spans:
        first = [span.start for span in spans]
        table[:, 1:4] = np.minimum.reduceat(position, first)
        table[:, 4:7] = np.maximum.reduceat(position, first)
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
    """CHNK of the columns (chunks, COLUMNS).

    ``shared``: length and CRC of the four headers; ``crcs``: of all chunks' positions, then of
    their other parts.
    """
    wide = table.astype(np.int64)
    parts = [wide[at : at + GROUP] for at in range(0, len(wide), GROUP)]
    sums = np.array([_join(part) for part in parts], np.int64).reshape(-1, COLUMNS)
    groups = []
    for i, (part, total) in enumerate(zip(parts, sums, strict=True)):
        own = slice(GROUP * i, GROUP * (i + 1))
        both = [*crcs[: len(wide)][own], *crcs[len(wide) :][own]]
        coded = runlength.encode(_relative(part, total).astype(np.int32))
        groups.append(struct.pack(f"<{2 * len(part)}I", *both) + coded)
    places = [number for group in groups for number in measure(group)]
    rows = runlength.encode(_relative(sums, np.zeros(COLUMNS, np.int64)).astype(np.int32))
    more = struct.pack(f"<{len(places)}I", *places) + rows
    start = _HEAD.pack(chunk, len(table), *shared, len(rows))
    crc = struct.pack("<I", _codec.crc32c(start + more))
    return b"".join([start, crc, more, *groups])


def _join(rows: Wide) -> Wide:
    """The row of a group of chunks."""
    total: Wide = rows.sum(axis=0)
    total[1:4], total[4:7] = rows[:, 1:4].min(axis=0), rows[:, 4:7].max(axis=0)
    return total


def _relative(rows: Wide, total: Wide) -> Wide:
    """Rows as they are coded.

    Least corners minus those before, greatest minus least, bytes minus the share of ``total``.
    """
    relative = rows.copy()
    relative[1:, 1:4] -= rows[:-1, 1:4]
    relative[:1, 1:4] -= total[1:4]
    relative[:, 4:7] -= rows[:, 1:4]
    relative[:, 7:] -= _shares(rows[:, 0], total)
    return relative


def _absolute(relative: Wide, total: Wide) -> Wide:
    """The rows that ``_relative`` was given."""
    rows = relative.copy()
    rows[:1, 1:4] += total[1:4]
    rows[:, 1:4] = np.cumsum(rows[:, 1:4], axis=0)
    rows[:, 4:7] += rows[:, 1:4]
    rows[:, 7:] += _shares(rows[:, 0], total)
    return rows


def _shares(anchors: Wide, total: Wide) -> Wide:
    """Bytes (rows, 4) in proportion to ``anchors``, rounded down."""
    return anchors[:, None] * total[7:] // max(int(total[0]), 1)


def _starts(rows: Wide, first: Wide) -> Wide:
    """Sums (rows, 5) of anchors and bytes over the rows before, from ``first`` on."""
    sizes = rows[:, [0, 7, 8, 9, 10]]
    return np.asarray(first + np.cumsum(sizes, axis=0) - sizes)


def head_size(data: bytes | memoryview) -> int:
    """Bytes of the whole head, from its first HEAD_SIZE ones.

    Raises:
        ValueError: they are fewer.
    """
    if len(data) < HEAD_SIZE:
        raise ValueError(f"{len(data)} bytes, at least {HEAD_SIZE} are needed")
    _, count, *_, rows = _HEAD.unpack_from(data)
    return int(HEAD_SIZE + 8 * -(-count // GROUP) + rows)


def unpack_head(data: bytes | memoryview) -> Head:
    """The head, of ``head_size`` bytes.

    Raises:
        ValueError: it is damaged.
    """
    chunk, count, *shared, _ = _HEAD.unpack_from(data)
    groups = -(-count // GROUP)
    crc = int.from_bytes(data[_HEAD.size : HEAD_SIZE], "little")
    if _codec.crc32c(b"".join([data[: _HEAD.size], data[HEAD_SIZE:]])) != crc:
        raise ValueError("checksum of the head differs")
    numbers = struct.unpack_from(f"<{2 * groups}I", data, HEAD_SIZE)
    coded = runlength.decode(data[HEAD_SIZE + 8 * groups :], groups, COLUMNS).astype(np.int64)
    offsets = len(data) + np.cumsum([0, *numbers[::2]])
    places = [
        (Part(int(at), length), crc)
        for at, length, crc in zip(offsets, numbers[::2], numbers[1::2], strict=False)
    ]
    headers = {
        tag: (Part(0, shared[2 * column]), shared[2 * column + 1])
        for column, tag in enumerate(TAGS)
    }
    rows = _absolute(coded, np.zeros(COLUMNS, np.int64))
    return Head(chunk, count, headers, rows, places, int(offsets[-1]))


def check_head(head: Head, anchors: int, grid: Grid) -> None:
    """Raise ValueError unless ``head`` fits a file of ``anchors`` anchors on ``grid``."""
    counts = head.groups[:, 0]
    if not 1 <= head.chunk <= MAX_CHUNK or (counts < 1).any() or int(counts.sum()) != anchors:
        raise ValueError(f"chunks do not hold {anchors} anchors, 1 to {MAX_CHUNK} each")
    if (head.groups[:, 7:] < 0).any():
        raise ValueError("a group has a negative length")
    least, greatest = head.groups[:, 1:4], head.groups[:, 4:7]
    if (abs(head.groups[:, 1:7] * 2 + 1) > 2**32).any() or (least > greatest).any():
        raise ValueError("corners of a group are outside of int32, or in another order")
    _check_corners(least, greatest, grid)


def _check_corners(least: Wide, greatest: Wide, grid: Grid) -> None:
    """Raise ValueError unless the grid is the smallest that holds all corners."""
    origin = np.array(grid.origin, np.int64)
    if len(least) == 0:
        if grid.depth > 0 or origin.any():
            raise ValueError("a grid without anchors")
        return
    if (least.min(axis=0) != origin).any():
        raise ValueError("corners of a group do not fit the origin")
    if int((greatest - origin).max()).bit_length() != grid.depth:
        raise ValueError(f"corners of a group do not fit depth {grid.depth}")


def unpack_group(data: bytes | memoryview, head: Head, index: int) -> list[Chunk]:
    """The chunks of group ``index``.

    Raises:
        ValueError: they are damaged, or do not fit the head.
    """
    count = min(GROUP, head.count - GROUP * index)
    if len(data) < 8 * count:
        raise ValueError(f"{len(data)} bytes cannot hold {count} chunks")
    crcs = struct.unpack_from(f"<{2 * count}I", data)
    total = head.groups[index]
    coded = runlength.decode(data[8 * count :], count, COLUMNS).astype(np.int64)
    rows = _absolute(coded, total)
    _check_group(rows, total, head.chunk)
    starts = _starts(rows, head.starts()[index])
    return [
        _chunk(GROUP * index + i, row, start, (crcs[i], crcs[count + i]))
        for i, (row, start) in enumerate(zip(rows.tolist(), starts.tolist(), strict=True))
    ]


def _check_group(rows: Wide, total: Wide, chunk: int) -> None:
    """Raise ValueError unless the chunks are those of the group that the head has."""
    if (rows[:, 0] < 1).any() or (rows[:, 0] > chunk).any():
        raise ValueError(f"numbers of anchors per chunk are not in [1, {chunk}]")
    if (rows[:, 7:] < 0).any():
        raise ValueError("a chunk has a negative length")
    if (rows[:, 1:4] > rows[:, 4:7]).any() or (_join(rows) != total).any():
        raise ValueError("chunks do not fit their group")


def _chunk(number: int, row: list[int], start: list[int], crcs: tuple[int, int]) -> Chunk:
    x, y, z = row[1:4]
    right, top, far = row[4:7]
    parts = {tag: Part(start[1 + i], row[7 + i]) for i, tag in enumerate(TAGS)}
    span = slice(start[0], start[0] + row[0])
    return Chunk(number, span, (x, y, z), (right, top, far), parts, *crcs)


def make_grid(position: npt.NDArray[np.int32], level: str) -> Grid:
    """The smallest grid that holds ``position`` (A, 3) int32."""
    if len(position) == 0:
        return Grid((0, 0, 0), 0, level)
    (x, y, z), high = position_coder.corners(position)
    return Grid((x, y, z), max(high[0] - x, high[1] - y, high[2] - z).bit_length(), level)
