"""A file of a scene, opened: its sections, and its chunks one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import chunks, octree, row_coder, sections
from clgs.codec.chunks import (
    HEAD_SIZE,
    TAGS,
    ByteRange,
    Chunk,
    Details,
    known_channels,
    unpack_details,
)
from clgs.codec.meta import (
    SCALING_DIM,
    Layer,
    unpack_geor,
    unpack_layers,
    unpack_meta,
    unpack_phot,
    unpack_weights,
)
from clgs.codec.sections import (
    ANCH,
    BODY,
    CHNK,
    DETL,
    FEAT,
    GEOR,
    LAYR,
    META,
    MLPS,
    OFFS,
    PHOT,
    SCAL,
    RandomAccess,
    Section,
    SectionTable,
    damage,
)
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.errors import CodecError
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene

CHANNELS = {OFFS: 3 * K_OFFSETS, FEAT: FEATURE_DIM, SCAL: SCALING_DIM}
"""Channels of the sections that hold attributes."""

Meets: TypeAlias = Callable[[npt.NDArray[np.int64], npt.NDArray[np.int64]], npt.NDArray[np.bool_]]
"""Which of the boxes with these least and greatest corners (n, 3) are wanted."""

_T = TypeVar("_T")


class SceneReader:
    """META and the head of CHNK, checked, and functions for the chunks, which threads may share.

    ``layers``: of a file in layers, else none; ``details``: what its last one adds, or None.

    Raises:
        CodecError: one of them is damaged, or other sections are not as long as CHNK says.
    """

    def __init__(self, source: RandomAccess, table: SectionTable) -> None:
        self._source = source
        self._entries = table.entries
        self.meta = guarded(sections.read_section(source, table.entries[META]), unpack_meta)
        if GEOR in table.entries:
            geor = sections.read_section(source, table.entries[GEOR])
            frame, place = guarded(geor, unpack_geor)
            transform = replace(self.meta.transform, frame=frame, place=place)
            self.meta = replace(self.meta, transform=transform)
        if PHOT in table.entries:
            photos = guarded(sections.read_section(source, table.entries[PHOT]), unpack_phot)
            settings = replace(self.meta.settings, photos=photos)
            self.meta = replace(self.meta, settings=settings)
        part = self._read(CHNK, ByteRange(0, min(HEAD_SIZE, table.entries[CHNK].length)))
        rest = self._read(CHNK, ByteRange(HEAD_SIZE, guarded(part, chunks.head_size) - HEAD_SIZE))
        part = Section(CHNK, part.offset, memoryview(b"".join([part.data, rest.data])))
        self.head = head = guarded(part, chunks.unpack_head)
        guarded(part, lambda _: chunks.check_head(head, self.meta))
        layered = LAYR in table.entries
        self.details: Details | None = None
        if DETL in table.entries:
            listed = sections.read_section(source, table.entries[DETL])
            self.details = guarded(listed, unpack_details, head.count, head.length(BODY))
        sizes = {CHNK: head.size, **{tag: head.length(tag) for tag in TAGS}}
        if layered:
            shared = {tag: place.length for tag, (place, _) in head.headers.items()}
            details = self.details.size if self.details else 0
            sizes |= {**shared, BODY: head.length(BODY) + details}
        # No count is believed before there are bytes that can hold it.
        for tag, size in sizes.items():
            length = table.entries[tag].length
            if length != size:
                raise self.error(tag, f"{length} bytes, its chunks have {size}")
        if head.headers[ANCH] != (ByteRange(0, 0), 0):
            raise self.error(ANCH, "a header that must be empty")
        self.layers: list[Layer] = []
        if layered:
            part = sections.read_section(source, table.entries[LAYR])
            self.layers = guarded(part, unpack_layers, head.count)
        self._home = {tag: BODY if layered else tag for tag in TAGS}
        self._fetched: dict[tuple[int, bool], Section] = {}

    def chunks(self, meets: Meets | None = None) -> list[Chunk]:
        """All chunks, or those whose box ``meets`` takes; then other groups are not read.

        Raises:
            CodecError: a group is damaged.
        """
        groups = self.head.groups
        met = meets(groups[:, 1:4], groups[:, 4:7]) if meets else np.ones(len(groups), bool)
        listed = [chunk for index in np.flatnonzero(met).tolist() for chunk in self._group(index)]
        if meets is None or not listed:
            return listed
        corners = (np.array([getattr(c, name) for c in listed]) for name in ("least", "greatest"))
        return [listed[i] for i in np.flatnonzero(meets(*corners)).tolist()]

    def _group(self, index: int) -> list[Chunk]:
        """The chunks of a group, after all checks that need no decoding."""
        part = self._verified(CHNK, *self.head.places[index], f"checksum of group {index} differs")
        listed = guarded(part, chunks.unpack_group, self.head, index, bool(self.layers))
        for chunk in listed:
            length = chunk.places[ANCH].length
            if len(chunk) > length * octree.MAX_POINTS_PER_BYTE:
                what = f"chunk {chunk.number}: {length} bytes cannot hold {len(chunk)} points"
                raise self.error(self._home[ANCH], what)
        return listed

    @property
    def body(self) -> int:
        """Where BODY begins, in a file in layers."""
        return self._entries[BODY].offset

    @property
    def layer_count(self) -> int:
        """How many layers the file was made with, that of details included; 0 without layers."""
        return len(self.layers) + (self.details is not None)

    def layer_ends(self) -> list[int]:
        """The number of chunks up to the end of each layer of anchors; none without layers."""
        return list(accumulate(layer.chunks for layer in self.layers))

    def whole_layers(self) -> int:
        """How many layers the file has, without those that it is cut in or before.

        Raises:
            CodecError: the file is cut before the first one ends, or a group is damaged.
        """
        there = self._source.size - self.body
        if there >= self._entries[BODY].length:
            return self.layer_count
        listed = [chunk for index in range(len(self.head.places)) for chunk in self._group(index)]
        whole = sum(listed[end - 1].end <= there for end in self.layer_ends())
        if whole == 0:
            missing = listed[self.layers[0].chunks - 1].end - there
            what = f"the file is cut {missing} bytes before the end of layer 1"
            raise CodecError(f"{what} of {self.layer_count}; copy it again")
        return whole

    def fetch(self, listed: list[Chunk], details: bool = False) -> None:
        """Read the chunks of a file in layers, or their details, neighbours at once, to keep."""
        places = [self._range(chunk, details) for chunk in listed]
        runs: list[list[int]] = []
        for i, place in enumerate(places):
            if i > 0 and places[i - 1].offset + places[i - 1].length == place.offset:
                runs[-1].append(i)
            else:
                runs.append([i])
        for run in runs:
            length = sum(places[i].length for i in run)
            part = self._read(BODY, ByteRange(places[run[0]].offset, length))
            for i in run:
                at = places[i].offset - places[run[0]].offset
                section = Section(BODY, part.offset + at, part.data[at : at + places[i].length])
                self._fetched[listed[i].number, details] = section

    def _range(self, chunk: Chunk, details: bool) -> ByteRange:
        """The bytes of a chunk of a file in layers, or of its details."""
        if not details:
            return ByteRange(chunk.start, chunk.end - chunk.start)
        assert self.details is not None
        start, lengths = self.details.starts[chunk.number, 0], self.details.lengths[chunk.number]
        return ByteRange(int(start), int(lengths.sum(dtype=np.int64)))

    def positions(self, chunk: Chunk) -> npt.NDArray[np.int32]:
        """Positions (n, 3) int32 of a chunk; CodecError if the chunk is damaged."""
        name = f"chunk {chunk.number}"
        part = self._part(chunk, ANCH)
        if _codec.crc32c(part.data) != chunk.position_crc:
            raise part.error(f"{name}: checksum differs")
        corner, depth = octree.enclosing_cell(chunk.least, chunk.greatest, self.meta.origin)
        try:
            position = octree.decode_in(part.data, len(chunk), corner, depth)
        except ValueError as error:
            raise part.error(f"{name}: {error}") from error
        low, high = octree.bounds(position)
        if low != chunk.least:
            raise part.error(f"{name}: least position is {list(low)}")
        if high != chunk.greatest:
            raise part.error(f"{name}: greatest position is {list(high)}")
        return position

    def streams(self, chunk: Chunk) -> dict[str, Section]:
        """The bytes of the attributes of a chunk, by section; CodecError if they are damaged."""
        parts = {tag: self._part(chunk, tag) for tag in CHANNELS}
        joined = b"".join(part.data for part in parts.values())
        if _codec.crc32c(joined) != chunk.rows_crc:
            places = ", ".join(f"{tag} at byte {part.offset}" for tag, part in parts.items())
            what = f"chunk {chunk.number}: the checksum that all of them share differs"
            raise damage(f"sections {places}", what)
        return parts

    def model(self, tag: str) -> row_coder.RowModel:
        """The model that all chunks of section ``tag`` share.

        Raises:
            CodecError: the section's header is damaged.
        """
        part = self._verified(tag, *self.head.headers[tag], "checksum of the header differs")
        return guarded(part, row_coder.read, CHANNELS[tag])

    def detail_streams(self, chunk: Chunk) -> dict[str, Section]:
        """The bytes of the details of a chunk, by section; CodecError if they are damaged."""
        assert self.details is not None
        place = self._range(chunk, True)
        part = self._fetched.get((chunk.number, True)) or self._read(BODY, place)
        if _codec.crc32c(part.data) != self.details.crcs[chunk.number]:
            raise part.error(f"chunk {chunk.number}: the checksum of its details differs")
        found = {}
        for tag, own in self.details.places(chunk.number).items():
            at = own.offset - place.offset
            found[tag] = Section(BODY, part.offset + at, part.data[at : at + own.length])
        return found

    def detail_model(self, tag: str) -> row_coder.RowModel:
        """The model that the details of all chunks share; CodecError if its header is damaged."""
        assert self.details is not None
        place, crc = self.details.headers[tag]
        part = self._verified(BODY, place, crc, f"checksum of the header for {tag} differs")
        channels = 2 * CHANNELS[tag]
        return guarded(part, row_coder.read, channels, known_channels(channels))

    def weights(self) -> npt.NDArray[np.float32]:
        """The weights of the MLPs (13710,) float32; CodecError if the section is damaged."""
        return decode_weights(sections.read_section(self._source, self._entries[MLPS]))

    def scene(self, anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]) -> QuantizedScene:
        """The scene of ``anchors`` with the file's settings."""
        meta = self.meta
        return QuantizedScene(anchors, Mlps(weights), meta.scales, meta.settings, meta.transform)

    def error(self, tag: str, what: str) -> Exception:
        """A CodecError that names section ``tag``."""
        return Section(tag, self._entries[tag].offset, memoryview(b"")).error(what)

    def _part(self, chunk: Chunk, tag: str) -> Section:
        """The bytes of a chunk that section ``tag`` has in a file without layers."""
        place = chunk.places[tag]
        if (fetched := self._fetched.get((chunk.number, False))) is None:
            return self._read(self._home[tag], place)
        at = place.offset - chunk.start
        return Section(BODY, fetched.offset + at, fetched.data[at : at + place.length])

    def _read(self, tag: str, place: ByteRange) -> Section:
        entry, end = self._entries[tag], place.offset + place.length
        if end > entry.length:
            raise self.error(tag, f"{entry.length} bytes, {end} are needed")
        offset = entry.offset + place.offset
        return Section(tag, offset, self._source.read(offset, place.length))

    def _verified(self, tag: str, place: ByteRange, crc: int, otherwise: str) -> Section:
        """Bytes of a section with this checksum; ``otherwise`` is the message if it differs."""
        part = self._read(tag, place)
        if _codec.crc32c(part.data) != crc:
            raise part.error(otherwise)
        return part


def decode_weights(section: Section) -> npt.NDArray[np.float32]:
    """The weights (13710,) float32 of section MLPS; CodecError if the section is damaged."""
    decoded = guarded(section, unpack_weights)
    if not np.isfinite(decoded).all():
        raise section.error("a weight is not finite")
    return decoded


def guarded(section: Section, function: Callable[..., _T], *arguments: object) -> _T:
    """``function(data, *arguments)``, its ValueError as a CodecError that names the section."""
    try:
        return function(section.data, *arguments)
    except ValueError as error:
        raise section.error(str(error)) from error
