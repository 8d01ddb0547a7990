"""Attribute rows to chunks of bytes and back, under a model that all chunks share.

A model is fitted to all rows once; its header and any one chunk suffice to decode that chunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import attribute_search
from clgs.codec.attribute_model import CHANNEL, KNOWN, SIDED, Ints, Models, NearRows, looks_near
from clgs.codec.attribute_search import RowChunks
from clgs.codec.octree import runs

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

RAW, PAPER = b"\0", b"\2"
"""Headers of chunks that share nothing: int32 as they are, which for noise is the shortest, or
streams of the paper's run-length coder. The header of tables begins with 1.
"""


@dataclass(frozen=True)
class RowModel:
    """What the chunks of one attribute share. Safe to use from several threads.

    channels: columns of the rows; header: the bytes that ``read`` makes the model of; tables: the
    predictions, classes and tables of every channel, None if the header is RAW or PAPER alone.
    """

    channels: int
    header: bytes
    tables: Models | None = None

    @property
    def looks_near(self) -> bool:
        """Whether chunks depend on the near rows, if there are any."""
        return self.tables is not None and looks_near(self.tables)

    def encode(self, rows: Ints, near: Ints | None = None) -> bytes:
        """The bytes of a chunk ``rows`` (n, channels) int32 of the rows that were fitted.

        ``near`` has its near rows; it is needed if the model was fitted with them and looks at
        them.
        """
        if self.header == RAW:
            return np.asarray(rows, "<i4").tobytes()
        rows = np.ascontiguousarray(rows, np.int32)
        if self.tables is None:
            return _codec.paper_encode(rows, self.channels)
        return _codec.attributes_encode(self.tables, rows, near) if len(rows) else b""

    def decode(
        self,
        data: bytes | memoryview,
        count: int,
        near: Ints | None = None,
        known: Ints | None = None,
    ) -> Ints:
        """The ``count`` rows (count, channels) int32 of a chunk, ``near`` as for ``encode``.

        ``known``: an array of these rows, to be filled, with the values of known channels, else 0.

        Raises:
            ValueError: the chunk is damaged, or holds another number of rows.
        """
        rows = np.empty((count, self.channels), np.int32) if known is None else known
        if self.header == RAW:
            if len(data) != rows.nbytes:
                raise ValueError(f"the stream has {len(data)} bytes for {count} rows")
            rows[:] = np.frombuffer(data, "<i4").reshape(rows.shape)
        elif self.tables is None:
            _codec.paper_decode(data, rows, self.channels)
        elif count > 0:
            _codec.attributes_decode(self.tables, data, rows, near)
        elif len(data) > 0:
            raise ValueError("bytes follow the last symbol of the stream")
        return rows


def table_model(tables: Models) -> RowModel:
    """The model of ``tables`` (channels,), with their header."""
    return RowModel(len(tables), _codec.attributes_header(tables), tables)


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
        return RowModel(channels, RAW)
    if level == "paper":
        return RowModel(channels, PAPER)
    values = np.ascontiguousarray(values, np.int32)
    chunks = runs(rows, chunk) if isinstance(chunk, int) else chunk
    all_rows = RowChunks(values, chunks, near)
    model, size = attribute_search.fit(all_rows, search=level in ("default", "max"))
    tables, paper = table_model(model), RowModel(channels, PAPER)
    if values.size <= EXACT_SIZE[level]:
        models = [tables, paper, RowModel(channels, RAW)]
        if _mixes(level, all_rows):
            models.insert(0, table_model(attribute_search.choose_mixed(model, all_rows)))
        return min(models, key=lambda one: _size(one, all_rows))
    if size >= 4 * values.size:
        return RowModel(channels, RAW)
    if level == "fast":
        return tables
    many = values.size > PLAIN_SIZE
    paper_size = (_sampled_size if many else _size)(paper, all_rows)
    if not many and abs(paper_size - size) < size // 100:  # too close for an estimate
        size = _size(tables, all_rows)
    return paper if paper_size < size else tables


def fit_details(
    values: Ints, step: int, level: str, chunks: list[slice], near: NearRows
) -> RowModel:
    """The model of ``values`` (n, 2 channels) int32: quotients by ``step``, and what they leave.

    Readers have the quotients already.
    """
    rows = RowChunks(np.ascontiguousarray(values, np.int32), chunks, near, step)
    model, _ = attribute_search.fit(rows, search=level in ("default", "max"))
    return table_model(attribute_search.choose_mixed(model, rows) if _mixes(level, rows) else model)


def _mixes(level: str, rows: RowChunks) -> bool:
    return level == "max" and len(rows.values) >= LEAST_MIXED_ROWS * len(rows.chunks)


def _size(model: RowModel, rows: RowChunks) -> int:
    chunks = rows.with_near(model.tables)
    return len(model.header) + sum(len(model.encode(values, near)) for values, near in chunks)


def _sampled_size(model: RowModel, rows: RowChunks) -> int:
    """About the same, from a sample in chunks of the mean length."""
    sample, count = attribute_search.take_sample(rows.values), len(rows.values)
    parts = runs(len(sample), min(len(sample), -(-count // len(rows.chunks))))
    return _size(model, RowChunks(sample, parts)) * count // len(sample)


def read(
    header: bytes | memoryview, channels: int, known: npt.NDArray[np.bool_] | None = None
) -> RowModel:
    """The model of a header; ValueError if it is damaged, or other channels are ``known``."""
    if known is None and header in (RAW, PAPER):
        return RowModel(channels, bytes(header))
    model = np.zeros(channels, CHANNEL)
    _codec.attributes_read(header, model)
    if ((model["coder"] == KNOWN) != (False if known is None else known)).any():
        raise ValueError("other channels are known than must be")
    if known is None and (model["coder"] == SIDED).any():
        raise ValueError("a sided channel, but none is known")
    return RowModel(channels, bytes(header), model)
