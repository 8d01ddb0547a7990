"""A quantised scene to the bytes of a .clgs file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_choice, check_integer, check_type
from clgs.codec import octree, row_coder, smaller
from clgs.codec.attribute_model import NearRows
from clgs.codec.chunks import (
    DEFAULT_CHUNK,
    MAX_CHUNK,
    MIN_CHUNK,
    STEP,
    TAGS,
    attribute_rows,
    interleave,
    pack_details,
    pack_directory,
    round_attributes,
)
from clgs.codec.meta import (
    LEVELS,
    WEIGHT_MODES,
    Layer,
    Meta,
    array_hash,
    check_meta,
    content_arrays,
    content_hash,
    join_hashes,
    pack_geor,
    pack_layers,
    pack_phot,
    pack_weights,
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
    write_container,
)
from clgs.errors import CodecError, UsageError
from clgs.machine import workers
from clgs.options import MAX_LAYERS
from clgs.scene.anchors import QuantizedAnchors, take
from clgs.scene.camera import UNKNOWN
from clgs.scene.mlps import MLP_SIZE
from clgs.scene.scene import QuantizedScene
from clgs.scene.world import LOCAL
from clgs.shapes import Shapes

DETAILS = {tag: f"details of {tag}" for tag in (OFFS, FEAT, SCAL)}
"""The names that details have among the streams of an encoder."""


def encode(
    scene: QuantizedScene,
    level: str = "default",
    chunk: int | None = None,
    threads: int | None = None,
    mlp: str = "auto",
    layers: int | None = None,
    importance: npt.NDArray[np.float64] | None = None,
    details: bool = False,
) -> bytes:
    """The .clgs file of ``scene``: a pure function of it and of the options but ``threads``.

    Args:
        scene: rows may come in any order; the file keeps them in Morton order.
        level: one of LEVELS; slower levels make smaller files.
        chunk: anchors that are decoded together, at most: 16 to 2^20. Small ones let a box of the
            scene be read without the rest, and cost bytes. Default: 65,536, or 1024 in layers.
        threads: at most this many, by default one per processor; no byte depends on it.
        mlp: one of ``WEIGHT_MODES``, how the weights are stored; lossless either way.
        layers: cut the scene into this many layers, 1 to 64, the most useful anchors first: the
            beginning of the file up to the end of a layer is a coarser scene.
        importance: of each anchor (A,) float64, at least 0, for ``layers``; default:
            ``clgs.codec.smaller``, opacity times area as seen from all around.
        details: the last of several layers adds no anchors, but the precision of all others, whose
            integers are rounded to multiples of ``clgs.codec.chunks.STEP`` before it; see
            :func:`suits_details`.

    Raises:
        CodecError: positions repeat or span 2^21 cells, or a weight or setting is not a sensible
            number; the message names the field and the remedy.
        UsageError: no such level or mode, a chunk or a number of threads or layers out of range,
            or an importance without layers.
        ValueError: ``importance`` has another shape, or a number that is not finite or below 0.
        TypeError: ``scene`` is no quantised scene, a chunk or number of threads no integer, or a
            level or mode no string.
    """
    check_type("scene", scene, QuantizedScene, "a run has it as .scene, clgs.load_scene reads one")
    if chunk is None:
        chunk = DEFAULT_CHUNK if layers is None else smaller.CHUNK
    check_options(level, chunk, mlp, layers, importance is not None)
    _check_scene(scene)
    detailed = details and layers is not None and layers > 1
    with workers(threads) as pool:
        whole = anchors = sort_anchors(scene.anchors, pool.map)
        ends = [0, len(anchors)]
        if layers is not None:
            anchors, ends = _in_layers(scene, whole, layers, importance, detailed)
        position = anchors.position
        rows, detail_rows = attribute_rows(anchors), dict[str, npt.NDArray[np.int32]]()
        if detailed:
            anchors, step = round_attributes(anchors)
            rows, detail_rows = _split(rows, attribute_rows(anchors), step)
        cuts = [octree.cut(position, chunk, slice(*layer_ends)) for layer_ends in pairwise(ends)]
        spans = [span for cut in cuts for span in cut]
        near = NearRows(position, spans)
        origins = octree.cell_corners(position, spans)
        every = rows | detail_rows

        def encode_positions(batch: range) -> list[bytes]:
            return [octree.encode_in(position[spans[i]], origins[i]) for i in batch]

        def encode_rows(tag: str, model: row_coder.RowModel, batch: range) -> list[bytes]:
            near_of = near.of if model.looks_near else lambda index: None
            return [model.encode(every[tag][spans[i]], near_of(i)) for i in batch]

        # What takes longest begins first.
        hashes = pool.map(array_hash, content_arrays(whole, scene.mlps.flat))
        models = {tag: pool.submit(row_coder.fit, rows[tag], level, spans, near) for tag in rows}
        for tag, both in detail_rows.items():
            models[tag] = pool.submit(row_coder.fit_details, both, step, level, spans, near)
        batches = octree.batches(spans)
        tasks = {ANCH: [pool.submit(encode_positions, batch) for batch in batches]}
        packed = pool.submit(pack_weights, scene.mlps.flat, mlp)
        for tag, model in models.items():
            tasks[tag] = [pool.submit(encode_rows, tag, model.result(), batch) for batch in batches]
        streams = {tag: [data for task in tasks[tag] for data in task.result()] for tag in tasks}
        headers = {ANCH: b"", **{tag: model.result().header for tag, model in models.items()}}
        content = join_hashes(list(hashes))
    least, greatest = octree.bounds(position) if len(position) else ((0, 0, 0), (0, 0, 0))
    depth = max(high - low for low, high in zip(least, greatest, strict=True)).bit_length()
    meta = Meta(
        *(len(anchors), scene.scales, scene.transform, scene.settings, content),
        *(least, depth, level),
    )
    optional = _optional_sections(scene)
    directory = pack_directory(chunk, position, spans, headers, streams)
    front = {META: meta.pack(), CHNK: directory}
    if layers is None:
        joined = {tag: b"".join([headers[tag], *streams[tag]]) for tag in TAGS}
        return write_container({**front, **joined, MLPS: packed.result(), **optional})
    listed = [
        Layer(len(cut), content_hash(take(anchors, slice(*layer_ends)), scene.mlps.flat))
        for cut, layer_ends in zip(cuts, pairwise(ends), strict=True)
    ]
    in_turn = zip(*(streams[tag] for tag in TAGS), strict=True)
    last = {BODY: b"".join(data for parts in in_turn for data in parts)}
    if detailed:
        of_details = {tag: (headers[name], streams[name]) for tag, name in DETAILS.items()}
        section, details_of_chunks = pack_details(step, of_details)
        last = {DETL: section, BODY: last[BODY] + details_of_chunks}
    last = {LAYR: pack_layers(listed), **last}
    shared = {tag: headers[tag] for tag in TAGS}
    return write_container({**front, **shared, MLPS: packed.result(), **optional, **last})


def _optional_sections(scene: QuantizedScene) -> dict[str, bytes]:
    """What the world and the photos of a scene are, as far as it is known."""
    transform, photos = scene.transform, scene.settings.photos
    found = {}
    if transform.frame != LOCAL:
        found[GEOR] = pack_geor(transform.frame, transform.place)
    if photos != UNKNOWN:
        found[PHOT] = pack_phot(photos)
    return found


def sort_anchors(
    anchors: QuantizedAnchors, run: Callable[..., Iterable[npt.NDArray[np.int32]]] = map
) -> QuantizedAnchors:
    """The anchors in Morton order of their positions; ``run`` may be the ``map`` of a pool.

    Raises:
        CodecError: positions repeat or span 2^21 cells.
    """
    order = octree.morton_order(anchors.position)
    if (order[1:] > order[:-1]).all():
        return anchors
    arrays = (array for _, array in anchors.items())
    return QuantizedAnchors(*run(lambda array: array[order], arrays))


def _check_scene(scene: QuantizedScene) -> None:
    """Raise CodecError unless weights and settings are numbers that a file may hold."""
    flat = scene.mlps.flat
    Shapes(M=MLP_SIZE).check("mlps", flat, "M", np.float32)
    bad = np.flatnonzero(~np.isfinite(flat))
    if len(bad):
        raise CodecError(f"mlps: weight {bad[0]} is {flat[bad[0]]}; train the scene again")
    try:
        check_meta(len(scene.anchors), scene.scales, scene.transform, scene.settings)
    except ValueError as error:
        raise CodecError(f"header: {error}, which no file may hold; correct the scene") from error


def suits_details(scene: QuantizedScene, layers: int) -> bool:
    """Whether the last of ``layers`` should add precision: the rest keeps enough of it.

    That is at least one integer per unit of features, as coarse as the paper's. Coarser anchors
    show less than some of them in all their precision.
    """
    return layers > 2 and scene.scales.feature >= STEP


def _in_layers(
    scene: QuantizedScene,
    whole: QuantizedAnchors,
    layers: int,
    importance: npt.NDArray[np.float64] | None,
    detailed: bool,
) -> tuple[QuantizedAnchors, list[int]]:
    """The anchors ``whole``, in Morton order, layer by layer; where layers begin, and the end."""
    if importance is not None:
        importance = np.asarray(importance, np.float64)
        Shapes(A=len(whole)).check("importance", importance, "A", np.float64)
        if not (np.isfinite(importance).all() and (importance >= 0).all()):
            raise ValueError("importance: a number is not finite or below 0")
        importance = importance[octree.morton_order(scene.anchors.position)]
    ordered, details = replace(scene, anchors=whole), int(detailed)
    layer = smaller.choose_layers(ordered, layers - details, importance, details)
    ends = [0, *np.cumsum(np.bincount(layer)).tolist()]
    return take(whole, np.argsort(layer, kind="stable")), ends


def _split(
    rows: dict[str, npt.NDArray[np.int32]], rounded: dict[str, npt.NDArray[np.int32]], step: int
) -> tuple[dict[str, npt.NDArray[np.int32]], dict[str, npt.NDArray[np.int32]]]:
    """The coarse values of ``rows``; and, by DETAILS, these next to what is left of them."""
    coarse = {tag: array // step for tag, array in rounded.items()}
    return coarse, {DETAILS[tag]: interleave(coarse[tag], rows[tag] - rounded[tag]) for tag in rows}


def check_options(
    level: str,
    chunk: int | None,
    mlp: str = "auto",
    layers: int | None = None,
    ordered: bool = False,
) -> None:
    """Raise UsageError or TypeError unless ``encode`` takes these options.

    ``ordered``: whether an importance of the anchors is given, too.
    """
    if ordered and layers is None:
        raise UsageError("importance: orders the anchors of a file in layers; give layers, too")
    if layers is not None and not 1 <= check_integer("layers", layers) <= MAX_LAYERS:
        raise UsageError(f"layers: {layers}; 1 to {MAX_LAYERS} are possible")
    check_choice("level", level, LEVELS)
    if chunk is not None and not MIN_CHUNK <= check_integer("chunk", chunk) <= MAX_CHUNK:
        raise UsageError(f"chunk: {chunk}; {MIN_CHUNK} to {MAX_CHUNK} anchors are possible")
    check_choice("mlp", mlp, WEIGHT_MODES)
