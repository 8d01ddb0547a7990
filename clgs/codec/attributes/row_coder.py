"""Attribute rows to chunks of bytes and back, under a model that all chunks share.

A model is fitted to all rows once; its header and any one chunk suffice to decode that chunk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.attributes import model_search
from clgs.codec.attributes.model import CHANNEL, Ints, Models
from clgs.codec.attributes.model_search import Rows
from clgs.codec.attributes.near import NearRows
from clgs.codec.attributes.paper import PaperModel
from clgs.codec.octree.subtrees import runs

LEVELS = ("fast", "default", "max", "paper")
"""Tables alone; predictions and classes too; mixing as well; the paper's coder, to compare with."""

CHUNK = 65536
"""Rows per chunk by default."""

MAX_CHANNELS = 256

EXACT_SIZE = {"fast": 1 << 16, "default": 1 << 18, "max": 1 << 62}
"""Up to this many values, coders are compared by encoding; above, their costs are estimated."""

PLAIN_SIZE = 1 << 22
"""Level default compares with the paper's coder on up to this many values; above, on a sample."""

LEAST_MIXED_ROWS = 256
"""Mixed channels learn too little in chunks that are shorter on average."""


class Model(Protocol):
    """What the chunks of one attribute share. Safe to use from several threads."""

    @property
    def header(self) -> bytes:
        """The bytes that ``read`` makes the model of."""

    @property
    def channels(self) -> int:
        """Columns of the rows."""

    @property
    def looks_near(self) -> bool:
        """Whether chunks depend on the near rows, if there are any."""

    def encode(self, rows: Ints, near: Ints | None = None) -> bytes:
        """The chunk of ``rows`` (n, channels) int32, a chunk of those that were fitted.

        ``near``: its near rows if it was fitted with positions and ``looks_near``.
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
class TableModel:
    """Predictions, classes and tables of every channel."""

    header: bytes
    model: Models
    MODE: ClassVar[int] = 1
    """The first byte of the header: a model of every channel follows."""

    @property
    def channels(self) -> int:
        """Columns of the rows."""
        return len(self.model)

    @property
    def looks_near(self) -> bool:
        """Whether a prediction looks at near rows."""
        return model_search.looks_near(self.model)

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


def fit(
    values: npt.NDArray[np.int32],
    level: str = "default",
    chunk: int | list[slice] = CHUNK,
    near: NearRows | None = None,
) -> Model:
    """The model of ``values`` (n, channels) int32.

    Its rows will be coded ``chunk`` at a time, or in these chunks; with the near rows of each if
    the model ``looks_near`` and ``near`` is given.

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
    all_rows = Rows(values, chunks, near)
    model, size = model_search.fit(all_rows, search=level in ("default", "max"))
    tables = TableModel(_codec.attributes_header(model), model)
    paper = PaperModel(channels)
    if values.size <= EXACT_SIZE[level]:
        models: list[Model] = [tables, paper, RawModel(channels)]
        if level == "max" and rows >= LEAST_MIXED_ROWS * len(chunks):
            mixed = model_search.choose_mixed(model, all_rows)
            models.insert(0, TableModel(_codec.attributes_header(mixed), mixed))
        return min(models, key=lambda one: _size(one, all_rows))
    if size >= 4 * values.size:
        return RawModel(channels)
    if level == "fast":
        return tables
    return paper if _plain_is_smaller(paper, tables, size, all_rows) else tables


def _plain_is_smaller(plain: Model, tables: Model, size: int, rows: Rows) -> bool:
    """Whether ``plain`` takes fewer bytes than ``tables``, which take about ``size``."""
    if rows.values.size > PLAIN_SIZE:
        return _sampled_size(plain, rows.values, rows.chunks) < size
    plain_size = _size(plain, rows)
    close = abs(plain_size - size) < size // 100
    return plain_size < (_size(tables, rows) if close else size)


def _size(model: Model, rows: Rows) -> int:
    """Bytes of the header and of all chunks."""
    chunks = enumerate(rows.chunks)
    near = rows.near.of if rows.near and model.looks_near else lambda index: None
    return len(model.header) + sum(len(model.encode(rows.values[c], near(i))) for i, c in chunks)


def _sampled_size(model: Model, values: Ints, chunks: list[slice]) -> int:
    """The same, from a sample in chunks of the mean length."""
    sample = model_search.take_sample(values)
    parts = runs(len(sample), min(len(sample), -(-len(values) // len(chunks))))
    return _size(model, Rows(sample, parts)) * len(values) // len(sample)


def read(header: bytes | memoryview, channels: int) -> Model:
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
    return TableModel(bytes(header), model)
