"""The bytes of a .clgs file to the quantised scene, to a box of it, or to a description."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.arguments import check_integer
from clgs.codec import octree
from clgs.codec.attribute_model import NearRows
from clgs.codec.chunks import Chunk, attribute_rows, interleave, times
from clgs.codec.http_source import BrokenConnectionError, HttpSource
from clgs.codec.meta import array_hash, content_arrays, content_hash, join_hashes
from clgs.codec.reader import CHANNELS, SceneReader
from clgs.codec.row_coder import RowModel
from clgs.codec.sections import (
    BODY,
    CHNK,
    FEAT,
    LAYR,
    META,
    SCAL,
    BytesSource,
    RandomAccess,
    read_container,
    read_table,
)
from clgs.constants import K_OFFSETS
from clgs.errors import UsageError
from clgs.machine import workers
from clgs.scene.anchors import QuantizedAnchors, take
from clgs.scene.camera import UNKNOWN
from clgs.scene.region import Box
from clgs.scene.scene import QuantizedScene
from clgs.scene.world import in_words

Positions = npt.NDArray[np.int32]

EVERYWHERE = Box((-np.inf,) * 3, (np.inf,) * 3)


def decode(
    data: bytes | str,
    threads: int | None = None,
    layers: int | None = None,
    box: Box | None = None,
) -> QuantizedScene:
    """The scene that ``encode`` was given, rows in Morton order.

    Args:
        data: a whole file; one in layers may be cut after the first layer, and a UserWarning then
            says which layers it has. Or the http or https address of one: only what is needed is
            read, by range requests, and checked by the checksums of chunks. If the connection
            breaks, the layers that have come are the scene, with a UserWarning, too.
        threads: at most this many, by default one per processor.
        layers: of a file in layers, only this many, from the first on; others have one.
        box: only the anchors in it.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged anywhere.
        DataError: nothing answers at the address, not with the range that was asked for, or the
            connection breaks before the first layer has come.
        TypeError: ``data`` is neither bytes nor an address, or ``box`` no box.
        UsageError: the number of layers is below 1, or above what the file was made with.
    """
    if not isinstance(box, Box | None):
        raise TypeError(f"box: is {type(box).__name__}, give a clgs.scene.region.Box")
    if isinstance(data, str) and "://" in data:
        with closing(HttpSource(data)) as source:
            return decode_box(source, box or EVERYWHERE, threads, layers)
    if not isinstance(data, bytes | bytearray | memoryview):
        wanted = "bytes are needed; Path(name).read_bytes() reads a file"
        raise TypeError(f"data: is {type(data).__name__}, {wanted}")
    if box is not None:
        return decode_box(BytesSource(data), box, threads, layers)
    table, _ = read_container(data)
    reader = SceneReader(BytesSource(data), table)
    chosen = choose_layers(reader, layers)
    with workers(threads) as pool:
        under_way = pool.submit(reader.weights)
        chunks = reader.chunks()[: chosen.chunks]
        anchors = _decode_rows(reader, chunks, _decode_positions(reader, chunks, pool), pool)
        weights, ends = under_way.result(), [0]
        ends += [chunks[end - 1].span.stop for end in reader.layer_ends() if end <= len(chunks)]
        for number, (layer, rows) in enumerate(zip(reader.layers, pairwise(ends), strict=False), 1):
            if content_hash(take(anchors, slice(*rows)), weights) != layer.content_hash:
                raise reader.error(LAYR, f"the integers of layer {number} do not match their hash")
        if chosen.details:
            _add_details(reader, chunks, anchors, pool)
        anchors = _in_order(reader, anchors)
        if not chosen.whole:
            return reader.scene(anchors, weights)
        hashes = pool.map(array_hash, content_arrays(anchors, weights))
        if join_hashes(list(hashes)) != reader.meta.content_hash:
            raise reader.error(META, "the decoded integers do not match their hash")
    return reader.scene(anchors, weights)


@dataclass(frozen=True)
class ChosenLayers:
    """The layers that are decoded: their number, that of their chunks, and whether they are all.

    ``details``: whether the last one is that of details.
    """

    count: int
    chunks: int
    whole: bool
    details: bool = False


def choose_layers(reader: SceneReader, layers: int | None) -> ChosenLayers:
    """The first ``layers`` layers of a file, or all that it has; a UserWarning if it is cut.

    Raises:
        CodecError: the file is cut before its first layer ends.
        UsageError: ``layers`` is not a number of its layers.
    """
    count = max(reader.layer_count, 1)
    if layers is not None and not 1 <= check_integer("layers", layers) <= count:
        raise UsageError(f"layers: {layers}; the file has {count}, give 1 to {count}")
    if not reader.layers:
        return ChosenLayers(1, reader.head.count, True)
    there = reader.whole_layers()
    if there < (layers or count):
        warnings.warn(f"the file is cut; {_coarser(there, count)}", stacklevel=3)
    used = min(layers or count, there)
    ends = reader.layer_ends()
    details = used > len(ends)
    return ChosenLayers(used, ends[min(used, len(ends)) - 1], used == count, details)


def _coarser(there: int, count: int) -> str:
    names = "layer 1" if there == 1 else f"layers 1 to {there}"
    return f"it has {names} of {count}, a coarser scene"


def _fetch(reader: SceneReader, chunks: list[Chunk], chosen: ChosenLayers) -> ChosenLayers:
    """Read those of ``chunks`` that are of ``chosen`` layers; the layers that have come.

    Raises:
        BrokenConnectionError: that is none.
    """
    for number, (first, end) in enumerate(pairwise([0, *reader.layer_ends()])):
        if end > chosen.chunks:
            break
        try:
            reader.fetch([chunk for chunk in chunks if first <= chunk.number < end])
        except BrokenConnectionError as error:
            if number == 0:
                raise
            warnings.warn(f"{error}; {_coarser(number, reader.layer_count)}", stacklevel=4)
            return ChosenLayers(number, first, False)
    return chosen


def _in_order(reader: SceneReader, anchors: QuantizedAnchors) -> QuantizedAnchors:
    """The anchors of several layers in Morton order; CodecError if positions repeat."""
    if len(reader.layers) < 2:
        return anchors
    code = np.empty(len(anchors), np.uint64)
    _codec.morton_encode(anchors.position, code, *reader.meta.origin)
    order = np.argsort(code)
    if not octree.ascends(code[order]):
        raise reader.error(CHNK, "layers have an anchor in common")
    return take(anchors, order)


def decode_box(
    source: RandomAccess, box: Box, threads: int | None = None, layers: int | None = None
) -> QuantizedScene:
    """The scene with only the anchors whose position lies in ``box``; ``layers`` as of ``decode``.

    Only these are read: the section table, META, MLPS, the lists of chunks and the positions of
    those that meet the box, and the attributes of those that have an anchor in it. Of a file in
    layers, chunks that meet the box are read whole, neighbours at once. World positions are
    computed as for ``world_position`` of a scene archive.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged in what is read.
        UsageError: as ``decode``.
    """
    reader = SceneReader(source, read_table(source))
    chosen = choose_layers(reader, layers)

    def world(position: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.float64]:
        """Positions (A, 3) in the units of the input data; on each axis it never decreases."""
        return reader.meta.transform.to_world(position / np.float64(reader.meta.scales.position))

    with workers(threads) as pool:
        weights = pool.submit(reader.weights)
        met = reader.chunks(lambda least, greatest: box.meets(world(least), world(greatest)))
        if reader.layers:
            chosen = _fetch(reader, met, chosen)
        chunks = [chunk for chunk in met if chunk.number < chosen.chunks]
        positions = _decode_positions(reader, chunks, pool)
        inside = [box.holds(world(position)) for position in positions]
        used = [i for i, kept in enumerate(inside) if kept.any()]
        filled = [chunks[i] for i in used]
        anchors = _decode_rows(reader, filled, [positions[i] for i in used], pool)
        if chosen.details:
            try:
                reader.fetch(filled, details=True)
                _add_details(reader, filled, anchors, pool)
            except BrokenConnectionError as error:
                there, count = chosen.count - 1, reader.layer_count
                warnings.warn(f"{error}; {_coarser(there, count)}", stacklevel=3)
                chosen = ChosenLayers(there, chosen.chunks, False)
    kept = np.concatenate([np.empty(0, bool), *(inside[i] for i in used)])
    anchors, flat = _in_order(reader, take(anchors, kept)), weights.result()
    everything = chosen.whole and box == EVERYWHERE
    if everything and content_hash(anchors, flat) != reader.meta.content_hash:
        raise reader.error(META, "the decoded integers do not match their hash")
    return reader.scene(anchors, flat)


def _decode_positions(
    reader: SceneReader, chunks: list[Chunk], pool: ThreadPoolExecutor
) -> list[Positions]:

    def decode_batch(batch: range) -> list[Positions]:
        return [reader.positions(chunks[i]) for i in batch]

    decoded = pool.map(decode_batch, octree.batches([chunk.span for chunk in chunks]))
    return [position for batch in decoded for position in batch]


def _decode_rows(
    reader: SceneReader, chunks: list[Chunk], positions: list[Positions], pool: ThreadPoolExecutor
) -> QuantizedAnchors:
    """The anchors of some chunks, whose positions are known, without details.

    Rows are in the order of the file: layer by layer, each in Morton order.

    Raises:
        CodecError: a chunk is damaged, or does not follow the one before in Morton order.
    """
    position = np.concatenate([np.empty((0, 3), np.int32), *positions])
    code = np.empty(len(position), np.uint64)
    _codec.morton_encode(position, code, *reader.meta.origin)
    layer_of = np.searchsorted(reader.layer_ends(), [c.number for c in chunks], side="right")
    layer = np.repeat(layer_of, [len(one) for one in positions])
    if ((code[1:] <= code[:-1]) & (layer[1:] == layer[:-1])).any():
        raise reader.error(CHNK, "the chunks are not in Morton order")
    spans = [slice(*ends) for ends in pairwise(np.cumsum([0, *map(len, positions)]).tolist())]
    streams = [reader.streams(chunk) for chunk in chunks]
    offset = np.empty((len(position), K_OFFSETS, 3), np.int32)
    feature, scaling = (np.empty((len(position), CHANNELS[t]), np.int32) for t in (FEAT, SCAL))
    anchors = QuantizedAnchors(position, offset, feature, scaling)
    rows = attribute_rows(anchors)
    near = NearRows(position, spans)
    step = reader.details.step if reader.details else 1

    def fill(tag: str, model: RowModel, batch: range) -> None:
        for i in batch:
            stream, near_rows = streams[i][tag], near.of(i) if model.looks_near else None
            try:
                decoded = model.decode(stream.data, len(chunks[i]), near_rows)
                rows[tag][spans[i]] = decoded if step == 1 else times(decoded, step)
            except ValueError as error:
                raise stream.error(f"chunk {chunks[i].number}: {error}") from error

    batches = octree.batches(spans)
    models = {tag: reader.model(tag) for tag in rows}
    tasks = [pool.submit(fill, tag, models[tag], batch) for tag in rows for batch in batches]
    for task in tasks:
        task.result()
    return anchors


def _add_details(
    reader: SceneReader, chunks: list[Chunk], anchors: QuantizedAnchors, pool: ThreadPoolExecutor
) -> None:
    """Add to ``anchors``, in place, the details of their ``chunks``; CodecError if one is bad."""
    assert reader.details is not None
    step = reader.details.step
    spans = [slice(*ends) for ends in pairwise(np.cumsum([0, *map(len, chunks)]).tolist())]
    near = NearRows(anchors.position, spans)
    streams = [reader.detail_streams(chunk) for chunk in chunks]
    rows = attribute_rows(anchors)

    def add(tag: str, model: RowModel, batch: range) -> None:
        for i in batch:
            stream, near_rows = streams[i][tag], near.of(i) if model.looks_near else None
            known = interleave(rows[tag][spans[i]] // step)
            try:
                decoded = model.decode(stream.data, len(chunks[i]), near_rows, known)
            except ValueError as error:
                raise stream.error(f"details of chunk {chunks[i].number}: {error}") from error
            rows[tag][spans[i]] += decoded[:, 1::2]

    batches = octree.batches(spans)
    models = {tag: reader.detail_model(tag) for tag in rows}
    tasks = [pool.submit(add, tag, models[tag], batch) for tag in rows for batch in batches]
    for task in tasks:
        task.result()


def describe(data: bytes) -> dict[str, Any]:
    """Header and size of a file: plain numbers, ready for JSON; payloads are not decoded.

    Keys: version, bytes, missing (bytes, of a file in layers that is cut), anchors, extent (the
    corners of the anchors' box, in the units of the input data; absent if there are none), level,
    origin, depth, chunks (anchors per chunk at most, count), layers (of a file in layers: for each
    its anchors, the byte where it ends, and whether the file has it whole), scales, world (what
    these units are, in words), transform, settings (without photos if nothing is known of them),
    content_hash (hex), and sections (bytes by tag, ``container`` for the signature and the table).

    Raises:
        CodecError: as ``decode``, but for damage that only decoding can show.
    """
    table, sections = read_container(data)
    reader = SceneReader(BytesSource(data), table)
    meta = reader.meta
    sizes = {tag: len(section.data) for tag, section in sections.items()}
    if table.size > len(data):
        sizes[BODY] = len(data) - reader.body
    settings, photos = dict(vars(meta.settings)), meta.settings.photos
    settings.pop("photos")
    extent, groups = {}, reader.head.groups
    if len(groups):
        corners = np.stack([groups[:, 1:4].min(axis=0), groups[:, 4:7].max(axis=0)])
        world = meta.transform.to_world(corners / np.float64(meta.scales.position))
        extent = {"extent": dict(zip(("least", "greatest"), world.tolist(), strict=True))}
    return {
        "version": table.version,
        "bytes": len(data),
        **({"missing": table.size - len(data)} if table.size > len(data) else {}),
        "anchors": meta.anchors,
        **extent,
        "level": meta.level,
        "origin": meta.origin,
        "depth": meta.depth,
        "chunks": {"anchors": reader.head.chunk, "count": reader.head.count},
        **({"layers": describe_layers(reader, len(data))} if reader.layers else {}),
        "scales": dict(vars(meta.scales)),
        "world": in_words(meta.transform.frame, meta.transform.place),
        "transform": dict(vars(meta.transform)),
        "settings": settings | ({} if photos == UNKNOWN else {"photos": photos._asdict()}),
        "content_hash": meta.content_hash.hex(),
        "sections": {"container": len(data) - sum(sizes.values()), **sizes},
    }


def describe_layers(reader: SceneReader, size: int) -> list[dict[str, Any]]:
    """Anchors and end of each layer of a file of which there are ``size`` bytes.

    A layer of details adds no anchors.
    """
    chunks, body = reader.chunks(), reader.body
    found, done = [], 0
    for end in reader.layer_ends():
        last = chunks[end - 1]
        there = body + last.end <= size
        found.append({"anchors": last.span.stop - done, "end": body + last.end, "there": there})
        done = last.span.stop
    if reader.details is not None:
        end = body + reader.head.length(BODY) + reader.details.size
        found.append({"anchors": 0, "end": end, "there": end <= size})
    return found
