"""A file of a scene, opened: its sections, and its chunks one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import weights
from clgs.codec.attributes import row_coder
from clgs.codec.container import chunks, section_table
from clgs.codec.container.chunks import HEAD_SIZE, TAGS, Chunk, Head, Part
from clgs.codec.container.meta import SCALING_DIM, unpack_meta
from clgs.codec.container.section_table import (
    ANCH,
    CHNK,
    FEAT,
    META,
    MLPS,
    OFFS,
    SCAL,
    Section,
    Table,
)
from clgs.codec.container.source import Source
from clgs.codec.octree import position_coder, subtrees
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene

CHANNELS = {OFFS: 3 * K_OFFSETS, FEAT: FEATURE_DIM, SCAL: SCALING_DIM}
"""Channels of the sections that hold attributes."""

Meets: TypeAlias = Callable[[npt.NDArray[np.int64], npt.NDArray[np.int64]], npt.NDArray[np.bool_]]
"""Which of the boxes with these least and greatest corners (n, 3) are wanted."""

_T = TypeVar("_T")


class Reader:
    """META and CHNK of a file, checked, and functions for its chunks, which threads may share."""

    def __init__(self, source: Source, table: Table) -> None:
        self._source = source
        self._table = table
        self.meta = guarded(self._section(META), unpack_meta)
        self.head = self._read_head()
        self._check_lengths()

    def chunks(self, meets: Meets | None = None) -> list[Chunk]:
        """The chunks whose box ``meets`` takes, by default all; no other group is read.

        Raises:
            CodecError: a group is damaged.
        """
        corners = self.head.groups[:, 1:4], self.head.groups[:, 4:7]
        met = meets(*corners) if meets else np.ones(len(self.head.groups), bool)
        listed = [chunk for index in np.flatnonzero(met).tolist() for chunk in self._group(index)]
        if meets is None or not listed:
            return listed
        least, greatest = (
            np.array([c.least for c in listed]),
            np.array([c.greatest for c in listed]),
        )
        return [listed[i] for i in np.flatnonzero(meets(least, greatest)).tolist()]

    def _group(self, index: int) -> list[Chunk]:
        """The chunks of a group, after all checks that need no decoding."""
        place, crc = self.head.places[index]
        part = self._read(CHNK, place)
        if _codec.crc32c(part.data) != crc:
            raise part.error(f"checksum of group {index} differs")
        listed = guarded(part, chunks.unpack_group, self.head, index)
        for chunk in listed:
            length, count = chunk.parts[ANCH].length, chunk.span.stop - chunk.span.start
            if count > length * position_coder.MAX_POINTS_PER_BYTE:
                what = f"chunk {chunk.number}: {length} bytes cannot hold {count} points"
                raise self.error(ANCH, what)
        return listed

    def positions(self, chunk: Chunk) -> npt.NDArray[np.int32]:
        """Positions (n, 3) int32 of a chunk.

        Raises:
            CodecError: the chunk is damaged.
        """
        part = self._read(ANCH, chunk.parts[ANCH])
        if _codec.crc32c(part.data) != chunk.position_crc:
            raise part.error(f"chunk {chunk.number}: checksum differs")
        cell = subtrees.cell(chunk.least, chunk.greatest, self.meta.grid.origin)
        position = _in_chunk(
            part, chunk, lambda data, count: position_coder.decode_in(data, count, *cell)
        )
        low, high = position_coder.corners(position)
        if tuple(low) != chunk.least:
            raise part.error(f"chunk {chunk.number}: least position is {low}")
        if tuple(high) != chunk.greatest:
            raise part.error(f"chunk {chunk.number}: greatest position is {high}")
        return position

    def streams(self, chunk: Chunk) -> dict[str, Section]:
        """The bytes of the attributes of a chunk, by section.

        Raises:
            CodecError: they are damaged.
        """
        parts = {tag: self._read(tag, chunk.parts[tag]) for tag in CHANNELS}
        joined = b"".join(part.data for part in parts.values())
        if _codec.crc32c(joined) != chunk.rows_crc:
            places = ", ".join(f"{tag} at byte {part.offset}" for tag, part in parts.items())
            what = f"chunk {chunk.number}: the checksum that all of them share differs"
            raise section_table.damage(f"sections {places}", what)
        return parts

    def codes(self, position: npt.NDArray[np.int32]) -> npt.NDArray[np.uint64]:
        """Morton codes of positions that were checked to lie on the grid."""
        code = np.empty(len(position), np.uint64)
        _codec.morton_encode(position, code, *self.meta.grid.origin)
        return code

    def model(self, tag: str) -> row_coder.Model:
        """The model that all chunks of section ``tag`` share.

        Raises:
            CodecError: the section's header is damaged.
        """
        shared, crc = self.head.headers[tag]
        part = self._read(tag, shared)
        if _codec.crc32c(part.data) != crc:
            raise part.error("checksum of the header differs")
        return guarded(part, row_coder.read, CHANNELS[tag])

    def rows(
        self,
        model: row_coder.Model,
        stream: Section,
        chunk: Chunk,
        near: npt.NDArray[np.int32] | None,
    ) -> npt.NDArray[np.int32]:
        """Attributes (n, channels) int32 of a chunk, of one of its ``streams``.

        ``near``: its near rows if the model looks at them.

        Raises:
            CodecError: the chunk is damaged.
        """
        return _in_chunk(stream, chunk, lambda data, count: model.decode(data, count, near))

    def weights(self) -> npt.NDArray[np.float32]:
        """The weights of the MLPs (13710,) float32.

        Raises:
            CodecError: the section is damaged.
        """
        return decode_weights(self._section(MLPS))

    def scene(self, anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]) -> QuantizedScene:
        """The scene of ``anchors`` with the file's settings."""
        meta = self.meta
        return QuantizedScene(anchors, Mlps(weights), meta.scales, meta.settings, meta.transform)

    def error(self, tag: str, what: str) -> Exception:
        """A CodecError that names section ``tag``."""
        return Section(tag, self._table.entries[tag].offset, memoryview(b"")).error(what)

    def _section(self, tag: str) -> Section:
        return section_table.read_section(self._source, self._table.entries[tag])

    def _read_head(self) -> Head:
        part = self._read(CHNK, Part(0, min(HEAD_SIZE, self._table.entries[CHNK].length)))
        size = guarded(part, chunks.head_size)
        rest = self._read(CHNK, Part(HEAD_SIZE, size - HEAD_SIZE))
        part = Section(CHNK, part.offset, memoryview(b"".join([part.data, rest.data])))
        head = guarded(part, chunks.unpack_head)
        guarded(part, lambda _: chunks.check_head(head, self.meta.anchors, self.meta.grid))
        return head

    def _check_lengths(self) -> None:
        """No count is believed before there are bytes that can hold it."""
        declared = {CHNK: self.head.size, **{tag: self.head.length(tag) for tag in TAGS}}
        for tag, size in declared.items():
            length = self._table.entries[tag].length
            if length != size:
                raise self.error(tag, f"{length} bytes, its chunks have {size}")
        if self.head.headers[ANCH] != (Part(0, 0), 0):
            raise self.error(ANCH, "a header that must be empty")

    def _read(self, tag: str, part: Part) -> Section:
        entry = self._table.entries[tag]
        if part.offset + part.length > entry.length:
            raise self.error(tag, f"{entry.length} bytes, {part.offset + part.length} are needed")
        offset = entry.offset + part.offset
        return Section(tag, offset, self._source.read(offset, part.length))


def decode_weights(section: Section) -> npt.NDArray[np.float32]:
    """The weights (13710,) float32 of section MLPS.

    Raises:
        CodecError: the section is damaged.
    """
    decoded = guarded(section, weights.decode)
    if not np.isfinite(decoded).all():
        raise section.error("a weight is not finite")
    return decoded


def guarded(section: Section, function: Callable[..., _T], *arguments: object) -> _T:
    """``function(data, *arguments)``, its ValueError as a CodecError that names the section."""
    try:
        return function(section.data, *arguments)
    except ValueError as error:
        raise section.error(str(error)) from error


def _in_chunk(
    part: Section,
    chunk: Chunk,
    function: Callable[[memoryview, int], npt.NDArray[np.int32]],
) -> npt.NDArray[np.int32]:
    try:
        return function(part.data, chunk.span.stop - chunk.span.start)
    except ValueError as error:
        raise part.error(f"chunk {chunk.number}: {error}") from error
