"""Sections CHNK and DETL: which bytes belong to which anchors, and their details in the last layer.

Chunks are listed in groups, and the groups in a head, so that a reader of a part of the scene
reads only the lists that it needs. Chunks may hold values divided by an odd step and rounded; their
details are what is left of them (codec_c/FORMAT.md).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.meta import Meta
from clgs.codec.sections import ANCH, BODY, FEAT, OFFS, SCAL
from clgs.scene.anchors import QuantizedAnchors

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
        part, total = rows[own], _join(rows[own])
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


ROWS = TAGS[1:]
"""The sections that have details, in the order of the columns."""

STEP, MAX_STEP = 3, 255
"""The step that is written, and the greatest. At 5, all anchors of fox have 6 dB less than at 3."""

MAX_VALUE = 1 << 30
"""Values are divided if all are below it, so that no product leaves int32."""

_DETAIL_HEAD = struct.Struct("<7I")


@dataclass(frozen=True)
class Details:
    """What DETL says.

    headers: for each of ROWS the bytes in BODY that all chunks share, with their CRC; starts (n, 3)
    and lengths (n, 3): bytes of each chunk for each of ROWS, one after the other, in BODY; crcs:
    (n,) of these; size: bytes of all details in BODY.
    """

    step: int
    headers: dict[str, tuple[ByteRange, int]]
    starts: npt.NDArray[np.int64]
    lengths: npt.NDArray[np.int32]
    crcs: npt.NDArray[np.uint32]
    size: int

    def places(self, chunk: int) -> dict[str, ByteRange]:
        """The bytes of a chunk in BODY for each of ROWS."""
        parts = zip(self.starts[chunk].tolist(), self.lengths[chunk].tolist(), strict=True)
        return dict(zip(ROWS, (ByteRange(*part) for part in parts), strict=True))


def pack_details(step: int, coded: dict[str, tuple[bytes, list[bytes]]]) -> tuple[bytes, bytes]:
    """Section DETL, and what follows the chunks in BODY.

    ``coded`` has for each of ROWS the header that chunks share, and the details of each chunk.
    """
    headers, streams = zip(*(coded[tag] for tag in ROWS), strict=True)
    parts = [b"".join(chunk) for chunk in zip(*streams, strict=True)]
    shared = [number for header in headers for number in (len(header), _codec.crc32c(header))]
    crcs = struct.pack(f"<{len(parts)}I", *map(_codec.crc32c, parts))
    sizes = np.array([[len(data) for data in stream] for stream in streams], np.int32).T
    listed = _codec.runlength_encode(np.ascontiguousarray(sizes), len(ROWS))
    section = _DETAIL_HEAD.pack(step, *shared) + crcs + listed
    return section, b"".join([*headers, *parts])


def unpack_details(data: bytes | memoryview, chunks: int, begin: int) -> Details:
    """What DETL says of a file of ``chunks`` chunks, which end at byte ``begin`` of BODY.

    Raises:
        ValueError: it is cut, or a number is out of range.
    """
    if len(data) < _DETAIL_HEAD.size + 4 * chunks:
        raise ValueError(f"{len(data)} bytes cannot hold {chunks} chunks")
    step, *shared = _DETAIL_HEAD.unpack_from(data)
    if step % 2 == 0 or step > MAX_STEP:
        raise ValueError(f"step {step} is not an odd number up to {MAX_STEP}")
    crcs = np.frombuffer(data, "<u4", chunks, _DETAIL_HEAD.size)
    lengths = np.empty((chunks, len(ROWS)), np.int32)
    _codec.runlength_decode(data[_DETAIL_HEAD.size + 4 * chunks :], lengths, len(ROWS))
    if (lengths < 0).any():
        raise ValueError("a chunk has a negative length")
    first = list(accumulate(shared[::2], initial=begin))
    ranges = (ByteRange(at, length) for at, length in zip(first, shared[::2], strict=False))
    headers = dict(zip(ROWS, zip(ranges, shared[1::2], strict=True), strict=True))
    ends = first[-1] + np.cumsum(lengths, dtype=np.int64).reshape(lengths.shape)
    end = int(ends[-1, -1]) if chunks else first[-1]
    return Details(step, headers, ends - lengths, lengths, crcs, end - begin)


def round_attributes(anchors: QuantizedAnchors) -> tuple[QuantizedAnchors, int]:
    """The anchors with all but positions rounded to multiples of a step, and this step."""
    arrays = [array for name, array in anchors.items() if name != "position"]
    small = all(-MAX_VALUE < array.min() <= array.max() < MAX_VALUE for array in arrays)
    step = STEP if small else 1
    rounded = ((array + step // 2) // step * step for array in arrays)
    return QuantizedAnchors(anchors.position, *rounded), step


def attribute_rows(anchors: QuantizedAnchors) -> dict[str, npt.NDArray[np.int32]]:
    """The rows of each section of attributes; those that take longest to code come first."""
    offset = anchors.offset.reshape(len(anchors), anchors.offset.shape[1] * 3)
    return {FEAT: anchors.feature, OFFS: offset, SCAL: anchors.scaling}


def times(coarse: npt.NDArray[np.int32], step: int) -> npt.NDArray[np.int32]:
    """Coarse values as integers of the scene; ValueError if they are outside of int32."""
    values = coarse.astype(np.int64) * step
    if values.size and (values.min() < -(2**31) or values.max() >= 2**31):
        raise ValueError("a coarse value is outside of int32")
    return values.astype(np.int32)


def interleave(
    coarse: npt.NDArray[np.int32], rest: npt.NDArray[np.int32] | int = 0
) -> npt.NDArray[np.int32]:
    """Rows (n, 2 C) of each coarse value and what is left of it, as the attribute coder has it."""
    both = np.empty((len(coarse), 2 * coarse.shape[1]), np.int32)
    both[:, ::2], both[:, 1::2] = coarse, rest
    return both


def known_channels(channels: int) -> npt.NDArray[np.bool_]:
    """Which of 2 C = ``channels`` interleaved ones a reader has: the coarse values."""
    return np.array([channel % 2 == 0 for channel in range(channels)])
