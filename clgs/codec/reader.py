"""A file of version 2, opened: its sections, and its chunks one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import attributes, container, octree, weights
from clgs.codec.chunks import TAGS, Directory, Part, unpack_directory
from clgs.codec.container import ANCH, CHNK, FEAT, META, MLPS, OFFS, SCAL, Section, Table
from clgs.codec.meta import SCALING_DIM, Grid, Meta, unpack_meta
from clgs.codec.source import Source
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene

CHANNELS = {OFFS: 3 * K_OFFSETS, FEAT: FEATURE_DIM, SCAL: SCALING_DIM}
"""Channels of the sections that hold attributes."""

_T = TypeVar("_T")


class Reader:
    """META and CHNK of a file, checked, and functions for its chunks, which threads may share."""

    def __init__(self, source: Source, table: Table) -> None:
        self._source = source
        self._table = table
        self.meta = guarded(self._section(META), unpack_meta, table.major)
        self.directory = self._read_directory()
        self._check_lengths()

    @property
    def grid(self) -> Grid:
        """The grid, which every file of version 2 has."""
        assert self.meta.grid is not None
        return self.meta.grid

    def positions(self, index: int) -> npt.NDArray[np.int32]:
        """Positions (n, 3) int32 of a chunk.

        Raises:
            CodecError: the chunk is damaged.
        """
        part = self._read(ANCH, self.directory.parts[ANCH][index])
        if _codec.crc32c(part.data) != self.directory.position_crc[index]:
            raise part.error(f"chunk {index}: checksum differs")
        position = _in_chunk(part, index, octree.decode, self._count(index))
        low, high = position.min(axis=0), position.max(axis=0)
        if (low != self.directory.least[index]).any():
            raise part.error(f"chunk {index}: least position is {low.tolist()}")
        if (high != self.directory.greatest[index]).any():
            raise part.error(f"chunk {index}: greatest position is {high.tolist()}")
        return position

    def codes(self, position: npt.NDArray[np.int32]) -> npt.NDArray[np.uint64]:
        """Morton codes of positions that were checked to lie on the grid."""
        code = np.empty(len(position), np.uint64)
        _codec.morton_encode(position, code, *self.grid.origin)
        return code

    def model(self, tag: str) -> attributes.Model:
        """The model that all chunks of section ``tag`` share.

        Raises:
            CodecError: the section's header is damaged.
        """
        shared, crc = self.directory.headers[tag]
        part = self._read(tag, shared)
        if _codec.crc32c(part.data) != crc:
            raise part.error("checksum of the header differs")
        return guarded(part, attributes.read, CHANNELS[tag])

    def streams(self, index: int) -> dict[str, Section]:
        """The bytes of the attributes of a chunk, by section.

        Raises:
            CodecError: they are damaged.
        """
        parts = {tag: self._read(tag, self.directory.parts[tag][index]) for tag in CHANNELS}
        joined = b"".join(part.data for part in parts.values())
        if _codec.crc32c(joined) != self.directory.rows_crc[index]:
            raise parts[OFFS].error(f"chunk {index}: checksum of its attributes differs")
        return parts

    def rows(self, model: attributes.Model, stream: Section, index: int) -> npt.NDArray[np.int32]:
        """Attributes (n, channels) int32 of a chunk, of one of its ``streams``.

        Raises:
            CodecError: the chunk is damaged.
        """
        return _in_chunk(stream, index, model.decode, self._count(index))

    def weights(self) -> npt.NDArray[np.float32]:
        """The weights of the MLPs (13710,) float32.

        Raises:
            CodecError: the section is damaged.
        """
        return decode_weights(self._section(MLPS))

    def scene(self, anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]) -> QuantizedScene:
        """The scene of ``anchors`` with the file's settings."""
        return make_scene(self.meta, anchors, weights)

    def error(self, tag: str, what: str) -> Exception:
        """A CodecError that names section ``tag``."""
        return Section(tag, self._table.entries[tag].offset, memoryview(b"")).error(what)

    def _count(self, index: int) -> int:
        span = self.directory.spans[index]
        return int(span.stop - span.start)

    def _section(self, tag: str) -> Section:
        return container.read_section(self._source, self._table.entries[tag])

    def _read_directory(self) -> Directory:
        return guarded(self._section(CHNK), unpack_directory, self.meta.anchors, self.grid)

    def _check_lengths(self) -> None:
        """No count is believed before there are bytes that can hold it."""
        for tag in TAGS:
            length, declared = self._table.entries[tag].length, self.directory.length(tag)
            if length != declared:
                raise self.error(tag, f"{length} bytes, its chunks have {declared}")
        if self.directory.headers[ANCH][0].length > 0:
            raise self.error(ANCH, "a header that must be empty")
        for index, part in enumerate(self.directory.parts[ANCH]):
            length, count = part.length, self._count(index)
            if count > length * octree.MAX_POINTS_A_BYTE:
                raise self.error(ANCH, f"chunk {index}: {length} bytes cannot hold {count} points")

    def _read(self, tag: str, part: Part) -> Section:
        offset = self._table.entries[tag].offset + part.offset
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


def make_scene(
    meta: Meta, anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]
) -> QuantizedScene:
    """The scene of ``anchors`` with the settings of ``meta``."""
    return QuantizedScene(anchors, Mlps(weights), meta.scales, meta.settings, meta.transform)


def guarded(section: Section, function: Callable[..., _T], *arguments: object) -> _T:
    """``function(data, *arguments)``, its ValueError as a CodecError that names the section."""
    try:
        return function(section.data, *arguments)
    except ValueError as error:
        raise section.error(str(error)) from error


def _in_chunk(
    part: Section, index: int, function: Callable[..., npt.NDArray[np.int32]], count: int
) -> npt.NDArray[np.int32]:
    try:
        return function(part.data, count)
    except ValueError as error:
        raise part.error(f"chunk {index}: {error}") from error
