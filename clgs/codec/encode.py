"""A quantised scene to the bytes of a .clgs file."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt

from clgs.codec import container, octree, runlength
from clgs.codec.meta import CONTENT_HASH_SIZE, Meta
from clgs.errors import CodecError
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE
from clgs.scene.scene import QuantizedScene
from clgs.shapes import Shapes

MAX_ANCHORS = 12_000_000
"""Anchors of one file: their integers take 4 GiB."""


def encode(scene: QuantizedScene) -> bytes:
    """The .clgs file of ``scene``: a pure function of it, except that rows may come in any order.

    Raises:
        CodecError: positions repeat or span 2^21 cells, or a weight or setting is not a sensible
            number; the message names the field and the remedy.
    """
    anchors = sort_anchors(scene.anchors)
    _check_weights(scene.mlps.flat)
    if len(anchors) > MAX_ANCHORS:
        raise CodecError(f"anchors: {len(anchors)}, at most {MAX_ANCHORS} fit; prune the scene")
    content = hash_content(anchors, scene.mlps.flat)
    meta = Meta(len(anchors), scene.scales, scene.transform, scene.settings, content)
    try:
        meta.check()
    except ValueError as error:
        raise CodecError(f"header: {error}, which no file may hold; correct the scene") from error
    return container.write_container(
        {
            container.META: meta.pack(),
            container.ANCH: octree.encode(anchors.position),
            container.OFFS: runlength.encode(flatten(anchors.offset)),
            container.FEAT: runlength.encode(anchors.feature),
            container.SCAL: runlength.encode(anchors.scaling),
            container.MLPS: runlength.encode_weights(scene.mlps.flat),
        }
    )


def sort_anchors(anchors: QuantizedAnchors) -> QuantizedAnchors:
    """The anchors in Morton order of their positions.

    Raises:
        CodecError: positions repeat or span 2^21 cells.
    """
    order = octree.morton_order(anchors.position)
    return QuantizedAnchors(
        anchors.position[order],
        anchors.offset[order],
        anchors.feature[order],
        anchors.scaling[order],
    )


def hash_content(anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]) -> bytes:
    """First 8 bytes of SHA-256 over position, offset, feature, scaling, weights, little-endian."""
    digest = hashlib.sha256()
    for array in (anchors.position, anchors.offset, anchors.feature, anchors.scaling):
        digest.update(np.ascontiguousarray(array, "<i4").data)
    digest.update(np.ascontiguousarray(weights, "<f4").data)
    return digest.digest()[:CONTENT_HASH_SIZE]


def flatten(offset: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Offsets (A, K, 3) as rows (A, 3 K)."""
    return offset.reshape(len(offset), offset.shape[1] * 3)


def _check_weights(weights: npt.NDArray[np.float32]) -> None:
    Shapes(M=MLP_SIZE).check("mlps", weights, "M", np.float32)
    bad = np.flatnonzero(~np.isfinite(weights))
    if len(bad):
        raise CodecError(f"mlps: weight {bad[0]} is {weights[bad[0]]}; train the scene again")
