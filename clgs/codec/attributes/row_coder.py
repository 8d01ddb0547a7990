"""Attribute rows to chunks of bytes and back, under a model that all chunks share.

A model is fitted to all rows once; its header and any one chunk suffice to decode that chunk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from clgs import _codec
from clgs.codec.attributes import model_search
from clgs.codec.attributes.model import CHANNEL, Ints, Models, NearRows, looks_near
from clgs.codec.attributes.model_search import RowChunks
from clgs.codec.octree import runs
from clgs.codec.plain_rows import decode_paper, encode_paper

LEVELS = ("fast", "default", "max", "paper")
"""fast: tables alone; default: predictions and classes, too; max: mixing, too; paper: the coder of
the paper, to compare with."""

CHUNK = 65536
"""Rows per chunk by default."""

MAX_CHANNELS = 256

EXACT_SIZE = {"fast": 1 << 16, "default": 1 << 18, "max": 1 << 62}
"""Up to this many values, coders are compared by encoding; above, their costs are estimated."""

PLAIN_SIZE = 1 << 22
"""Level default compares with the paper's coder on up to this many values; above, on a sample."""

LEAST_MIXED_ROWS = 256
"""Mixed channels learn too little in chunks that are shorter on average."""


class RowModel(Protocol):
    """What the chunks of one attribute share. Safe to use from several threads."""

    @property
    def header(self) -> bytes:
        """The bytes that ``read`` makes the model of."""

    @property
    def channels(self) -> int:
        """How many columns the rows have."""

    @property
    def looks_near(self) -> bool:
        """Whether chunks depend on the near rows, if there are any."""

    def encode(self, rows: Ints, near: Ints | None = None) -> bytes:
        """The bytes of a chunk ``rows`` (n, channels) int32 of the rows that were fitted.

        ``near`` has its near rows; it is needed if the model was fitted with them and looks at
        them.
        """

    def decode(self, data: bytes | memoryview, count: int, near: Ints | None = None) -> Ints:
        """The ``count`` rows (count, channels) int32 of a chunk, ``near`` as for ``encode``.

        Raises:
            ValueError: the chunk is damaged, or holds another number of rows.
        """


@dataclass(frozen=True)
class RawModel:
    """Chunks are int32 as they are: no header is shorter, and noise gains nothing."""

    channels: int
    MODE: ClassVar[int] = 0
    """The first byte of the header: int32 as they are."""
    looks_near: ClassVar[bool] = False

    @property
    def header(self) -> bytes:
        """The mode alone."""
        return bytes([self.MODE])

    def encode(self, rows: Ints, near: Ints | None = None) -> bytes:
        """Rows as little-endian words."""
        return np.asarray(rows, "<i4").tobytes()

    def decode(self, data: bytes | memoryview, count: int, near: Ints | None = None) -> Ints:
        """Little-endian words as rows."""
        if len(data) != 4 * count * self.channels:
            raise ValueError(f"the stream has {len(data)} bytes for {count} rows")
        rows = np.frombuffer(data, "<i4").astype(np.int32)
        return rows.reshape(count, self.channels)


@dataclass(frozen=True)
class PaperModel:
    """Chunks are streams of the paper's plain run-length coder; nothing is shared."""

    channels: int
    MODE: ClassVar[int] = 2
    """The first byte of the header: plain run-length streams."""
    looks_near: ClassVar[bool] = False

    @property
    def header(self) -> bytes:
        """The mode alone."""
        return bytes([self.MODE])

    def encode(self, rows: Ints, near: Ints | None = None) -> bytes:
        """One stream."""
        return encode_paper(rows)

    def decode(self, data: bytes | memoryview, count: int, near: Ints | None = None) -> Ints:
        """The rows of one stream."""
        return decode_paper(data, count, self.channels)


@dataclass(frozen=True)
class TableModel:
    """Predictions, classes and tables of every channel."""

    model: Models
    header: bytes
    MODE: ClassVar[int] = 1
    """The first byte of the header: a model of every channel follows."""

    @property
    def channels(self) -> int:
        """How many columns the rows have."""
        return len(self.model)

    @property
    def looks_near(self) -> bool:
        """Whether a prediction looks at near rows."""
        return looks_near(self.model)

    def encode(self, rows: Ints, near: Ints | None = None) -> bytes:
        """One chunk; no bytes for no rows."""
        rows = np.ascontiguousarray(rows, np.int32)
        return _codec.attributes_encode(self.model, rows, near) if len(rows) else b""

    def decode(self, data: bytes | memoryview, count: int, near: Ints | None = None) -> Ints:
        """The rows of one chunk."""
        rows = np.empty((count, self.channels), np.int32)
        if count > 0:
            _codec.attributes_decode(self.model, data, rows, near)
        elif len(data) > 0:
            raise ValueError("bytes follow the last symbol of the stream")
        return rows


def make_table_model(model: Models) -> TableModel:
    """The tables of ``model``, with their header."""
    return TableModel(model, _codec.attributes_header(model))


def fit(
    values: Ints,
    level: str = "default",
    chunk: int | list[slice] = CHUNK,
    near: NearRows | None = None,
) -> RowModel:
    """The model of ``values`` (n, channels) int32.

    ``chunk``: how many rows are coded together, or the chunks themselves; ``near``: the near rows
    of the chunks if the rows have positions.

    Raises:
        ValueError: an unknown level, or a number of channels outside [1, 256].
    """
    if level not in LEVELS:
        raise ValueError(f"level {level!r}: use one of {', '.join(LEVELS)}")
    rows, channels = values.shape
    if not 1 <= channels <= MAX_CHANNELS:
        raise ValueError(f"{channels} channels: 1 to {MAX_CHANNELS} fit")
    if rows == 0:
        return RawModel(channels)
    if level == "paper":
        return PaperModel(channels)
    values = np.ascontiguousarray(values, np.int32)
    chunks = runs(rows, chunk) if isinstance(chunk, int) else chunk
    all_rows = RowChunks(values, chunks, near)
    model, size = model_search.fit(all_rows, search=level in ("default", "max"))
    tables, paper = make_table_model(model), PaperModel(channels)
    if values.size <= EXACT_SIZE[level]:
        models: list[RowModel] = [tables, paper, RawModel(channels)]
        if level == "max" and rows >= LEAST_MIXED_ROWS * len(chunks):
            models.insert(0, make_table_model(model_search.choose_mixed(model, all_rows)))
        return min(models, key=lambda one: _size(one, all_rows))
    if size >= 4 * values.size:
        return RawModel(channels)
    if level == "fast":
        return tables
    many = values.size > PLAIN_SIZE
    paper_size = (_sampled_size if many else _size)(paper, all_rows)
    if not many and abs(paper_size - size) < size // 100:  # too close for an estimate
        size = _size(tables, all_rows)
    return paper if paper_size < size else tables


def _size(model: RowModel, rows: RowChunks) -> int:
    """Bytes of the header and of all chunks."""
    chunks = enumerate(rows.chunks)
    near = rows.near.of if rows.near and model.looks_near else lambda index: None
    return len(model.header) + sum(len(model.encode(rows.values[c], near(i))) for i, c in chunks)


def _sampled_size(model: RowModel, rows: RowChunks) -> int:
    """About the same, from a sample in chunks of the mean length."""
    sample, count = model_search.take_sample(rows.values), len(rows.values)
    parts = runs(len(sample), min(len(sample), -(-count // len(rows.chunks))))
    return _size(model, RowChunks(sample, parts)) * count // len(sample)


def read(header: bytes | memoryview, channels: int) -> RowModel:
    """The model of a header.

    Raises:
        ValueError: the header is damaged.
    """
    if len(header) == 1 and header[0] == RawModel.MODE:
        return RawModel(channels)
    if len(header) == 1 and header[0] == PaperModel.MODE:
        return PaperModel(channels)
    model = np.zeros(channels, CHANNEL)
    _codec.attributes_read(header, model)
    return TableModel(model, bytes(header))
