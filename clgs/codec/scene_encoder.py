"""A quantised scene to the bytes of a .clgs file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from clgs.codec.arguments import check_choice, check_integer
from clgs.codec.attributes import row_coder
from clgs.codec.attributes.near import NearRows
from clgs.codec.container import section_table
from clgs.codec.container.chunks import (
    DEFAULT_CHUNK,
    MAX_CHUNK,
    MIN_CHUNK,
    TAGS,
    make_grid,
    pack_directory,
)
from clgs.codec.container.meta import (
    LEVELS,
    Meta,
    array_hash,
    check_meta,
    content_arrays,
    join_hashes,
)
from clgs.codec.container.section_table import ANCH, CHNK, FEAT, MLPS, OFFS, SCAL
from clgs.codec.octree import position_coder
from clgs.codec.octree.subtrees import batches, corners, cut
from clgs.codec.weights import MODES
from clgs.codec.weights import encode as encode_weights
from clgs.codec.workers import workers
from clgs.errors import CodecError, UsageError
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE
from clgs.scene.scene import QuantizedScene
from clgs.shapes import Shapes, check_type


def encode(
    scene: QuantizedScene,
    level: str = "default",
    chunk: int = DEFAULT_CHUNK,
    threads: int | None = None,
    mlp: str = "auto",
) -> bytes:
    """The .clgs file of ``scene``: a pure function of it, of ``level``, ``chunk`` and ``mlp``.

    Args:
        scene: rows may come in any order; the file keeps them in Morton order.
        level: one of LEVELS; slower levels make smaller files.
        chunk: anchors that are decoded together, at most: 16 to 2^20. Small ones let a box of the
            scene be read without the rest, and cost bytes.
        threads: at most this many, by default one per processor; no byte depends on it.
        mlp: one of ``weights.MODES``, how the weights are stored; lossless either way.

    Raises:
        CodecError: positions repeat or span 2^21 cells, or a weight or setting is not a sensible
            number; the message names the field and the remedy.
        UsageError: no such level or mode, or a chunk or number of threads out of range.
        TypeError: ``scene`` is no quantised scene, a chunk or number of threads no integer, or a
            level or mode no string.
    """
    check_type("scene", scene, QuantizedScene, "a run has it as .scene, clgs.load_scene reads one")
    check_options(level, chunk, mlp)
    _check_scene(scene)
    with workers(threads) as pool:
        anchors = sort_anchors(scene.anchors, pool.map)
        hashes = pool.map(array_hash, content_arrays(anchors, scene.mlps.flat))
        sections = _encode_sections(anchors, scene.mlps.flat, level, chunk, mlp, pool)
        content = join_hashes(list(hashes))
    grid = make_grid(anchors.position, level)
    meta = Meta(len(anchors), scene.scales, scene.transform, scene.settings, content, grid)
    return section_table.write_container({section_table.META: meta.pack(), **sections})


def sort_anchors(
    anchors: QuantizedAnchors, run: Callable[..., Iterable[npt.NDArray[np.int32]]] = map
) -> QuantizedAnchors:
    """The anchors in Morton order of their positions; ``run`` may be the ``map`` of a pool.

    Raises:
        CodecError: positions repeat or span 2^21 cells.
    """
    order = position_coder.morton_order(anchors.position)
    if (order[1:] > order[:-1]).all():
        return anchors
    arrays = (array for _, array in anchors.items())
    return QuantizedAnchors(*run(lambda array: array[order], arrays))


def flatten(offset: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Offsets (A, K, 3) as rows (A, 3 K)."""
    return offset.reshape(len(offset), offset.shape[1] * 3)


def _encode_sections(
    anchors: QuantizedAnchors,
    weights: npt.NDArray[np.float32],
    level: str,
    chunk: int,
    mlp: str,
    pool: ThreadPoolExecutor,
) -> dict[str, bytes]:
    """The sections but META; what takes longest is begun first."""
    rows = {FEAT: anchors.feature, OFFS: flatten(anchors.offset), SCAL: anchors.scaling}
    parts = cut(anchors.position, chunk)
    near = NearRows(anchors.position, parts)
    models = {tag: pool.submit(row_coder.fit, rows[tag], level, parts, near) for tag in rows}
    tasks = {ANCH: _encode_positions(anchors.position, parts, pool)}
    packed = pool.submit(encode_weights, weights, mlp)
    for tag, model in models.items():
        tasks[tag] = _encode_rows(model.result(), rows[tag], parts, near, pool)
    streams = {tag: [data for task in tasks[tag] for data in task.result()] for tag in TAGS}
    headers = {ANCH: b"", **{tag: model.result().header for tag, model in models.items()}}
    return {
        CHNK: pack_directory(chunk, anchors.position, parts, headers, streams),
        **{tag: b"".join([headers[tag], *streams[tag]]) for tag in TAGS},
        MLPS: packed.result(),
    }


def _encode_positions(
    position: npt.NDArray[np.int32], parts: list[slice], pool: ThreadPoolExecutor
) -> list[Future[list[bytes]]]:
    """The octrees of all parts, some of them per task."""
    origins = corners(position, parts)

    def encode_batch(batch: range) -> list[bytes]:
        return [position_coder.encode_in(position[parts[i]], origins[i]) for i in batch]

    return [pool.submit(encode_batch, batch) for batch in batches(parts)]


def _encode_rows(
    model: row_coder.Model,
    rows: npt.NDArray[np.int32],
    parts: list[slice],
    near: NearRows,
    pool: ThreadPoolExecutor,
) -> list[Future[list[bytes]]]:
    """The attributes of all parts, some of them per task."""

    def encode_batch(batch: range) -> list[bytes]:
        if model.looks_near:
            return [model.encode(rows[parts[i]], near.of(i)) for i in batch]
        return [model.encode(rows[parts[i]]) for i in batch]

    return [pool.submit(encode_batch, batch) for batch in batches(parts)]


def check_options(level: str, chunk: int, mlp: str = "auto") -> None:
    """Raise UsageError or TypeError unless ``encode`` takes these options."""
    check_choice("level", level, LEVELS)
    if not MIN_CHUNK <= check_integer("chunk", chunk) <= MAX_CHUNK:
        raise UsageError(f"chunk: {chunk}; {MIN_CHUNK} to {MAX_CHUNK} anchors are possible")
    check_choice("mlp", mlp, MODES)


def _check_scene(scene: QuantizedScene) -> None:
    """Raise CodecError if a number is one that no file may hold."""
    weights = scene.mlps.flat
    Shapes(M=MLP_SIZE).check("mlps", weights, "M", np.float32)
    bad = np.flatnonzero(~np.isfinite(weights))
    if len(bad):
        raise CodecError(f"mlps: weight {bad[0]} is {weights[bad[0]]}; train the scene again")
    try:
        check_meta(len(scene.anchors), scene.scales, scene.transform, scene.settings)
    except ValueError as error:
        raise CodecError(f"header: {error}, which no file may hold; correct the scene") from error
