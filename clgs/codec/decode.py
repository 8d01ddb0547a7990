"""The bytes of a .clgs file to the quantised scene, or to a description of the file."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.codec import container, octree, version1
from clgs.codec.container import CHNK, FEAT, META, OFFS, SCAL
from clgs.codec.content import array_hash, content_arrays, join_hashes
from clgs.codec.reader import CHANNELS, Reader
from clgs.codec.source import BytesSource
from clgs.codec.workers import workers
from clgs.constants import K_OFFSETS
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.scene import QuantizedScene


def decode(data: bytes, threads: int | None = None) -> QuantizedScene:
    """The scene that ``encode`` was given, rows in Morton order.

    Args:
        data: a whole file of version 1 or 2.
        threads: at most so many, by default one for each processor; version 1 takes one.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged anywhere.
    """
    table, sections = container.read_container(data)
    if table.major == 1:
        return version1.decode_sections(sections)
    reader = Reader(BytesSource(data), table)
    with workers(threads) as pool:
        weights = pool.submit(reader.weights)
        anchors = decode_anchors(reader, range(len(reader.spans)), pool)
        hashes = pool.map(array_hash, content_arrays(anchors, weights.result()))
        if join_hashes(list(hashes)) != reader.meta.content_hash:
            raise reader.error(META, "the decoded integers do not match their hash")
    return reader.scene(anchors, weights.result())


def decode_anchors(reader: Reader, chunks: range, pool: ThreadPoolExecutor) -> QuantizedAnchors:
    """The anchors of all ``chunks``.

    Raises:
        CodecError: a chunk is damaged, or does not follow the one before in Morton order.
    """
    positions = list(pool.map(reader.positions, chunks))
    position = np.concatenate([np.empty((0, 3), np.int32), *positions])
    if not octree.ascends(reader.codes(position)):
        raise reader.error(CHNK, "the chunks are not in Morton order")
    return decode_attributes(reader, position, chunks, pool)


def decode_attributes(
    reader: Reader, position: npt.NDArray[np.int32], chunks: range, pool: ThreadPoolExecutor
) -> QuantizedAnchors:
    """The anchors at ``position``, which is that of ``chunks``."""
    rows = {tag: np.empty((len(position), CHANNELS[tag]), np.int32) for tag in CHANNELS}
    tasks: list[Future[None]] = []
    for tag in (FEAT, OFFS, SCAL):
        model, start = reader.model(tag), 0
        for index in chunks:
            span = reader.spans[index]
            end = start + span.stop - span.start
            tasks.append(pool.submit(_fill, reader, model, tag, index, rows[tag][start:end]))
            start = end
    for task in tasks:
        task.result()
    offset = rows[OFFS].reshape(-1, K_OFFSETS, 3)
    return QuantizedAnchors(position, offset, rows[FEAT], rows[SCAL])


def _fill(reader: Reader, model: Any, tag: str, index: int, target: npt.NDArray[np.int32]) -> None:
    target[...] = reader.rows(model, tag, index)


def describe(data: bytes) -> dict[str, Any]:
    """Header and size of a file: plain numbers, ready for JSON; payloads are not decoded.

    Keys: version, bytes, anchors, scales, transform, settings, content_hash (hex), and sections
    (bytes by tag, ``container`` for the signature and the table); from version 2 on also level,
    origin, depth, and chunks (anchors of each, count).

    Raises:
        CodecError: as ``decode``, but for damage that only decoding can show.
    """
    table, sections = container.read_container(data)
    more: dict[str, Any] = {}
    if table.major == 1:
        meta = version1.read_meta(sections)
    else:
        reader = Reader(BytesSource(data), table)
        meta, grid = reader.meta, reader.grid
        chunks = {"anchors": reader.directory.chunk, "count": len(reader.spans)}
        more = {"level": grid.level, "origin": grid.origin, "depth": grid.depth, "chunks": chunks}
    sizes = {tag: len(section.data) for tag, section in sections.items()}
    return {
        "version": table.version,
        "bytes": len(data),
        "anchors": meta.anchors,
        **more,
        "scales": dict(vars(meta.scales)),
        "transform": dict(vars(meta.transform)),
        "settings": dict(vars(meta.settings)),
        "content_hash": meta.content_hash.hex(),
        "sections": {"container": len(data) - sum(sizes.values()), **sizes},
    }
