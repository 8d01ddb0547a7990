"""The bytes of a .clgs file to the quantised scene, or to a description of the file."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.codec.attributes.near import NearRows
from clgs.codec.attributes.row_coder import Model
from clgs.codec.container import section_table
from clgs.codec.container.chunks import Chunk
from clgs.codec.container.meta import array_hash, content_arrays, join_hashes
from clgs.codec.container.reader import CHANNELS, Reader
from clgs.codec.container.section_table import CHNK, FEAT, META, OFFS, SCAL
from clgs.codec.container.source import BytesSource
from clgs.codec.octree import position_coder
from clgs.codec.octree.subtrees import batches
from clgs.codec.workers import workers
from clgs.constants import K_OFFSETS
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.scene import QuantizedScene


def decode(data: bytes, threads: int | None = None) -> QuantizedScene:
    """The scene that ``encode`` was given, rows in Morton order.

    Args:
        data: a whole file.
        threads: at most this many, by default one per processor.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged anywhere.
        TypeError: ``data`` is no bytes, such as the name of a file.
    """
    if not isinstance(data, bytes | bytearray | memoryview):
        wanted = "bytes are needed; Path(name).read_bytes() reads a file"
        raise TypeError(f"data: is {type(data).__name__}, {wanted}")
    table, _ = section_table.read_container(data)
    reader = Reader(BytesSource(data), table)
    with workers(threads) as pool:
        weights = pool.submit(reader.weights)
        anchors = decode_chunks(reader, decode_positions(reader, reader.chunks(), pool), pool)
        hashes = pool.map(array_hash, content_arrays(anchors, weights.result()))
        if join_hashes(list(hashes)) != reader.meta.content_hash:
            raise reader.error(META, "the decoded integers do not match their hash")
    return reader.scene(anchors, weights.result())


@dataclass(frozen=True)
class Opened:
    """A chunk, and its positions (n, 3) int32."""

    chunk: Chunk
    position: npt.NDArray[np.int32]


def decode_positions(reader: Reader, chunks: list[Chunk], pool: ThreadPoolExecutor) -> list[Opened]:
    """The positions of some chunks in ascending order.

    Raises:
        CodecError: a chunk is damaged.
    """

    def open_batch(batch: range) -> list[Opened]:
        return [Opened(chunks[i], reader.positions(chunks[i])) for i in batch]

    decoded = pool.map(open_batch, batches([chunk.span for chunk in chunks]))
    return [opened for batch in decoded for opened in batch]


def decode_chunks(
    reader: Reader, opened: list[Opened], pool: ThreadPoolExecutor
) -> QuantizedAnchors:
    """The anchors of some chunks.

    Raises:
        CodecError: a chunk is damaged, or does not follow the one before in Morton order.
    """
    position = np.concatenate([np.empty((0, 3), np.int32), *(one.position for one in opened)])
    if not position_coder.ascends(reader.codes(position)):
        raise reader.error(CHNK, "the chunks are not in Morton order")
    stops = np.cumsum([0, *(len(one.position) for one in opened)]).tolist()
    spans = [slice(*ends) for ends in pairwise(stops)]
    streams = [reader.streams(one.chunk) for one in opened]
    rows = {tag: np.empty((len(position), CHANNELS[tag]), np.int32) for tag in CHANNELS}
    near = NearRows(position, spans)

    def fill(tag: str, model: Model, batch: range) -> None:
        for i in batch:
            near_rows = near.of(i) if model.looks_near else None
            rows[tag][spans[i]] = reader.rows(model, streams[i][tag], opened[i].chunk, near_rows)

    tasks: list[Future[None]] = []
    for tag in (FEAT, OFFS, SCAL):
        model = reader.model(tag)
        tasks += [pool.submit(fill, tag, model, batch) for batch in batches(spans)]
    for task in tasks:
        task.result()
    offset = rows[OFFS].reshape(-1, K_OFFSETS, 3)
    return QuantizedAnchors(position, offset, rows[FEAT], rows[SCAL])


def describe(data: bytes) -> dict[str, Any]:
    """Header and size of a file: plain numbers, ready for JSON; payloads are not decoded.

    Keys: version, bytes, anchors, level, origin, depth, chunks (anchors per chunk at most, count),
    scales, transform, settings, content_hash (hex), and sections (bytes by tag, ``container`` for
    the signature and the table).

    Raises:
        CodecError: as ``decode``, but for damage that only decoding can show.
    """
    table, sections = section_table.read_container(data)
    reader = Reader(BytesSource(data), table)
    meta, grid = reader.meta, reader.meta.grid
    sizes = {tag: len(section.data) for tag, section in sections.items()}
    return {
        "version": table.version,
        "bytes": len(data),
        "anchors": meta.anchors,
        "level": grid.level,
        "origin": grid.origin,
        "depth": grid.depth,
        "chunks": {"anchors": reader.head.chunk, "count": reader.head.count},
        "scales": dict(vars(meta.scales)),
        "transform": dict(vars(meta.transform)),
        "settings": dict(vars(meta.settings)),
        "content_hash": meta.content_hash.hex(),
        "sections": {"container": len(data) - sum(sizes.values()), **sizes},
    }
