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
from clgs.codec.container.meta import Meta
from clgs.codec.container.sections import ANCH, BODY, FEAT, OFFS, SCAL

TAGS = (ANCH, OFFS, FEAT, SCAL)
"""The sections in chunks, in the order of the columns."""

DEFAULT_CHUNK = 65_536
MIN_CHUNK, MAX_CHUNK = 16, 1 << 20
"""Anchors per chunk, at most."""

GROUP = 64
"""Chunks per group; the last group has the rest."""

COLUMNS = 11
"""Per chunk or group: anchors, least x y z, greatest x y z, bytes in each of TAGS."""

_HEAD = struct.Struct("<11I")
HEAD_SIZE = _HEAD.size + 4
"""The first bytes of CHNK, which give the length of the rest of its head."""

Rows = npt.NDArray[np.int64]
"""(n, COLUMNS)."""


@dataclass(frozen=True)
class ByteRange:
    """A run of bytes of a section, at byte ``offset`` from its start."""

    offset: int
    length: int


@dataclass(frozen=True)
class DirectoryHead:
    """The head of CHNK.

    chunk: anchors per chunk, at most; count: number of chunks; headers: for each of TAGS the bytes
    that all its chunks share, with their CRC; groups (groups, COLUMNS); places: of every group its
    bytes in CHNK, with their CRC; size: bytes of CHNK.
    """

    chunk: int
    count: int
    headers: dict[str, tuple[ByteRange, int]]
    groups: Rows
    places: list[tuple[ByteRange, int]]
    size: int

    def length(self, tag: str) -> int:
        """Bytes of section ``tag``; of the chunks in all of TAGS if it is BODY."""
        if tag == BODY:
            return int(self.groups[:, 7:].sum())
        return self.headers[tag][0].length + int(self.groups[:, 7 + TAGS.index(tag)].sum())


@dataclass(frozen=True)
class Chunk:
    """Neighbouring anchors: their rows, their corners, and their bytes in each of TAGS.

    In a file in layers, the bytes are places of BODY, one after the other.
    ``position_crc`` is of the bytes in ANCH; ``rows_crc`` of those in the other sections, one
    after the other.
    """

    number: int
    span: slice
    least: tuple[int, int, int]
    greatest: tuple[int, int, int]
    places: dict[str, ByteRange]
    position_crc: int
    rows_crc: int

    def __len__(self) -> int:
        return int(self.span.stop - self.span.start)

    @property
    def start(self) -> int:
        """The first byte of a chunk in BODY."""
        return self.places[ANCH].offset

    @property
    def end(self) -> int:
        """The byte after the last one of a chunk in BODY."""
        return self.places[SCAL].offset + self.places[SCAL].length


def pack_directory(
    chunk: int,
    position: npt.NDArray[np.int32],
    spans: list[slice],
    headers: dict[str, bytes],
    streams: dict[str, list[bytes]],
) -> bytes:
    """Section CHNK of ``position`` (A, 3) int32 in Morton order, and the bytes of its chunks."""
    rows = np.empty((len(spans), COLUMNS), np.int64)
    rows[:, 0] = [span.stop - span.start for span in spans]
    if spans:
        first = [span.start for span in spans]
        rows[:, 1:4] = np.minimum.reduceat(position, first)
        rows[:, 4:7] = np.maximum.reduceat(position, first)
    for column, tag in enumerate(TAGS):
        rows[:, 7 + column] = [len(stream) for stream in streams[tag]]
    crcs = [_codec.crc32c(stream) for stream in streams[ANCH]]
    others = zip(*(streams[tag] for tag in TAGS[1:]), strict=True)
    crcs += [_codec.crc32c(b"".join(parts)) for parts in others]
    shared = [number for tag in TAGS for number in _length_and_crc(headers[tag])]
    return pack_rows(chunk, shared, crcs, rows)


def _length_and_crc(data: bytes) -> tuple[int, int]:
    return len(data), _codec.crc32c(data)


def pack_rows(chunk: int, shared: list[int], crcs: list[int], rows: Rows) -> bytes:
    """Section CHNK of the rows of all chunks.

    ``shared``: length and CRC of the four headers; ``crcs``: of the positions of all chunks, then
    of their other bytes.
    """
    groups, sums = [], np.empty((0, COLUMNS), np.int64)
    for start in range(0, len(rows), GROUP):
        own = slice(start, start + GROUP)
        part = rows[own]
        total = _join(part)
        both = [*crcs[: len(rows)][own], *crcs[len(rows) :][own]]
        groups.append(struct.pack(f"<{2 * len(part)}I", *both) + _encode_rows(part, total))
        sums = np.concatenate([sums, total[None]])
    places = [number for group in groups for number in _length_and_crc(group)]
    coded = _encode_rows(sums, np.zeros(COLUMNS, np.int64))
    start_of_head = _HEAD.pack(chunk, len(rows), *shared, len(coded))
    rest_of_head = struct.pack(f"<{len(places)}I", *places) + coded
    crc = struct.pack("<I", _codec.crc32c(start_of_head + rest_of_head))
    return b"".join([start_of_head, crc, rest_of_head, *groups])


def _join(rows: Rows) -> Rows:
    total: Rows = rows.sum(axis=0)
    total[1:4], total[4:7] = rows[:, 1:4].min(axis=0), rows[:, 4:7].max(axis=0)
    return total


def _encode_rows(rows: Rows, total: Rows) -> bytes:
    """The run-length stream of rows.

    Coded are least corners minus those before, greatest minus least, and bytes minus the share of
    ``total``.
    """
    relative = rows.copy()
    relative[1:, 1:4] -= rows[:-1, 1:4]
    relative[:1, 1:4] -= total[1:4]
    relative[:, 4:7] -= rows[:, 1:4]
    relative[:, 7:] -= _shares(rows[:, 0], total)
    return _codec.runlength_encode(relative.astype(np.int32), COLUMNS)


def _decode_rows(data: bytes | memoryview, count: int, total: Rows) -> Rows:
    """The ``count`` rows that ``_encode_rows`` was given; ValueError if ``data`` is damaged."""
    relative = np.empty((count, COLUMNS), np.int32)
    _codec.runlength_decode(data, relative, COLUMNS)
    rows = relative.astype(np.int64)
    rows[:1, 1:4] += total[1:4]
    rows[:, 1:4] = np.cumsum(rows[:, 1:4], axis=0)
    rows[:, 4:7] += rows[:, 1:4]
    rows[:, 7:] += _shares(rows[:, 0], total)
    return rows


def _shares(anchors: Rows, total: Rows) -> Rows:
    """Bytes (rows, 4) in proportion to ``anchors``, rounded down."""
    return anchors[:, None] * total[7:] // max(int(total[0]), 1)


def _starts(rows: Rows, first: Rows) -> Rows:
    """First anchor and first byte in each of TAGS of every row (rows, 5), from ``first`` on."""
    sizes = rows[:, [0, 7, 8, 9, 10]]
    return np.asarray(first + np.cumsum(sizes, axis=0) - sizes)


def _joined_starts(rows: Rows, first: Rows | None = None) -> Rows:
    """The same if the parts of a row follow each other, from ``first``'s anchor and byte on."""
    parts = np.cumsum(rows[:, 7:], axis=1)
    before = np.cumsum(parts[:, -1]) - parts[:, -1]
    anchors = np.cumsum(rows[:, 0]) - rows[:, 0]
    starts = np.concatenate([anchors[:, None], before[:, None] + parts - rows[:, 7:]], axis=1)
    return np.asarray(starts if first is None else starts + first[[0, 1, 1, 1, 1]])


def head_size(data: bytes | memoryview) -> int:
    """Bytes of the whole head, from its first HEAD_SIZE ones; ValueError if they are fewer."""
    if len(data) < HEAD_SIZE:
        raise ValueError(f"{len(data)} bytes, at least {HEAD_SIZE} are needed")
    _, count, *_, rows = _HEAD.unpack_from(data)
    return int(HEAD_SIZE + 8 * -(-count // GROUP) + rows)


def unpack_head(data: bytes | memoryview) -> DirectoryHead:
    """The head, of ``head_size`` bytes; ValueError if it is damaged."""
    chunk, count, *shared, _ = _HEAD.unpack_from(data)
    groups = -(-count // GROUP)
    crc = int.from_bytes(data[_HEAD.size : HEAD_SIZE], "little")
    if _codec.crc32c(b"".join([data[: _HEAD.size], data[HEAD_SIZE:]])) != crc:
        raise ValueError("checksum of the head differs")
    numbers = struct.unpack_from(f"<{2 * groups}I", data, HEAD_SIZE)
    rows = _decode_rows(data[HEAD_SIZE + 8 * groups :], groups, np.zeros(COLUMNS, np.int64))
    offsets = len(data) + np.cumsum([0, *numbers[::2]])
    places = [
        (ByteRange(int(at), length), crc)
        for at, length, crc in zip(offsets, numbers[::2], numbers[1::2], strict=False)
    ]
    headers = {
        tag: (ByteRange(0, length), crc)
        for tag, length, crc in zip(TAGS, shared[::2], shared[1::2], strict=True)
    }
    return DirectoryHead(chunk, count, headers, rows, places, int(offsets[-1]))


def check_head(head: DirectoryHead, meta: Meta) -> None:
    """Raise ValueError unless ``head`` fits a file with this META.

    The grid of META must be the smallest one that holds all corners.
    """
    counts = head.groups[:, 0]
    if not 1 <= head.chunk <= MAX_CHUNK or (counts < 1).any() or int(counts.sum()) != meta.anchors:
        raise ValueError(f"chunks do not hold {meta.anchors} anchors, 1 to {MAX_CHUNK} each")
    if (head.groups[:, 7:] < 0).any():
        raise ValueError("a group has a negative length")
    least, greatest = head.groups[:, 1:4], head.groups[:, 4:7]
    if (abs(head.groups[:, 1:7] * 2 + 1) > 2**32).any() or (least > greatest).any():
        raise ValueError("corners of a group are outside of int32, or in another order")
    if len(least) == 0:
        if meta.depth > 0 or any(meta.origin):
            raise ValueError("a grid without anchors")
        return
    origin = np.array(meta.origin, np.int64)
    if (least.min(axis=0) != origin).any():
        raise ValueError("corners of a group do not fit the origin")
    if int((greatest - origin).max()).bit_length() != meta.depth:
        raise ValueError(f"corners of a group do not fit depth {meta.depth}")


def unpack_group(
    data: bytes | memoryview, head: DirectoryHead, index: int, layered: bool = False
) -> list[Chunk]:
    """The chunks of group ``index``; ValueError if they are damaged, or do not fit the head.

    ``layered``: the four parts of a chunk lie together, in BODY.
    """
    first_chunk = GROUP * index
    count = min(GROUP, head.count - first_chunk)
    if len(data) < 8 * count:
        raise ValueError(f"{len(data)} bytes cannot hold {count} chunks")
    crcs = struct.unpack_from(f"<{2 * count}I", data)
    total = head.groups[index]
    rows = _decode_rows(data[8 * count :], count, total)
    if (rows[:, 0] < 1).any() or (rows[:, 0] > head.chunk).any():
        raise ValueError(f"numbers of anchors per chunk are not in [1, {head.chunk}]")
    if (rows[:, 7:] < 0).any():
        raise ValueError("a chunk has a negative length")
    if (rows[:, 1:4] > rows[:, 4:7]).any() or (_join(rows) != total).any():
        raise ValueError("chunks do not fit their group")
    headers = [0, *(head.headers[tag][0].length for tag in TAGS)]
    if layered:
        starts = _joined_starts(rows, _joined_starts(head.groups)[index])
    else:
        starts = _starts(rows, _starts(head.groups, np.array(headers, np.int64))[index])
    found = []
    for i, (row, start) in enumerate(zip(rows.tolist(), starts.tolist(), strict=True)):
        places = {tag: ByteRange(start[1 + k], row[7 + k]) for k, tag in enumerate(TAGS)}
        span = slice(start[0], start[0] + row[0])
        least, greatest = (row[1], row[2], row[3]), (row[4], row[5], row[6])
        number = first_chunk + i
        found.append(Chunk(number, span, least, greatest, places, crcs[i], crcs[count + i]))
    return found
