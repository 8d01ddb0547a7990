"""Files of version 1: no chunks; one octree and one run-length stream a section."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt

from clgs.codec.attributes import runlength
from clgs.codec.container.content_hash import content_arrays
from clgs.codec.container.meta import CONTENT_HASH_SIZE, Meta, unpack_meta
from clgs.codec.container.reader import CHANNELS, decode_weights, guarded, make_scene
from clgs.codec.container.section_table import ANCH, FEAT, META, MLPS, OFFS, SCAL, Section
from clgs.codec.octree import position_coder
from clgs.constants import K_OFFSETS
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.scene import QuantizedScene

MODE_2 = b"\x02"
"""The first byte of positions and weights in the way that begins with version 2."""


def read_meta(sections: dict[str, Section]) -> Meta:
    """Section META, its count checked against the bytes of the positions.

    Raises:
        CodecError: the section is damaged.
    """
    meta = guarded(sections[META], unpack_meta, 1)
    limit = len(sections[ANCH].data) * position_coder.MAX_POINTS_A_BYTE
    if meta.anchors > limit:
        raise sections[META].error(f"{meta.anchors} anchors declared, at most {limit} can follow")
    return meta


def decode_sections(sections: dict[str, Section]) -> QuantizedScene:
    """The scene that the sections hold.

    Raises:
        CodecError: a section is damaged.
    """
    meta = read_meta(sections)
    for tag in (ANCH, MLPS):
        if sections[tag].data[:1] == MODE_2:
            raise sections[tag].error("mode 2, which version 1 does not have")
    anchors = QuantizedAnchors(
        position=guarded(sections[ANCH], position_coder.decode, meta.anchors),
        offset=_rows(sections, OFFS, meta).reshape(-1, K_OFFSETS, 3),
        feature=_rows(sections, FEAT, meta),
        scaling=_rows(sections, SCAL, meta),
    )
    weights = decode_weights(sections[MLPS])
    if content_hash(anchors, weights) != meta.content_hash:
        raise sections[META].error("the decoded integers do not match their hash")
    return make_scene(meta, anchors, weights)


def content_hash(anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]) -> bytes:
    """First 8 bytes of SHA-256 over the arrays, little-endian."""
    digest = hashlib.sha256()
    for array in content_arrays(anchors, weights):
        digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).data)
    return digest.digest()[:CONTENT_HASH_SIZE]


def _rows(sections: dict[str, Section], tag: str, meta: Meta) -> npt.NDArray[np.int32]:
    return guarded(sections[tag], runlength.decode, meta.anchors, CHANNELS[tag])
