"""The bytes of a .clgs file to the quantised scene, or to a description of the file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from clgs.codec import container, octree, runlength
from clgs.codec.container import Section
from clgs.codec.encode import MAX_ANCHORS, hash_content
from clgs.codec.meta import SCALING_DIM, Meta, unpack_meta
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene

_T = TypeVar("_T")


def decode(data: bytes) -> QuantizedScene:
    """The scene that ``encode`` was given, rows in Morton order.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged anywhere.
    """
    sections = container.read_container(data)
    meta = _read_meta(sections)
    position = _guarded(sections["ANCH"], octree.decode, meta.anchors)
    anchors = QuantizedAnchors(
        position=position,
        offset=_decode_rows(sections["OFFS"], meta, 3 * K_OFFSETS).reshape(-1, K_OFFSETS, 3),
        feature=_decode_rows(sections["FEAT"], meta, FEATURE_DIM),
        scaling=_decode_rows(sections["SCAL"], meta, SCALING_DIM),
    )
    weights = _guarded(sections["MLPS"], runlength.decode_weights, MLP_SIZE)
    if not np.isfinite(weights).all():
        raise sections["MLPS"].error("a weight is not finite")
    if hash_content(anchors, weights) != meta.content_hash:
        raise sections["META"].error("the decoded integers do not match their hash")
    return QuantizedScene(anchors, Mlps(weights), meta.scales, meta.settings, meta.transform)


def describe(data: bytes) -> dict[str, Any]:
    """Header and size of a file: plain numbers, ready for JSON; payloads are not decoded.

    Keys: version, bytes, anchors, scales, transform, settings, content_hash (hex), and sections
    (bytes by tag, ``container`` for the signature and the table).

    Raises:
        CodecError: as ``decode``, but for damage that only decoding can show.
    """
    sections = container.read_container(data)
    meta = _read_meta(sections)
    sizes = {tag: len(section.data) for tag, section in sections.items()}
    return {
        "version": f"{container.MAJOR}.{int.from_bytes(data[10:12], 'little')}",
        "bytes": len(data),
        "anchors": meta.anchors,
        "scales": dict(vars(meta.scales)),
        "transform": dict(vars(meta.transform)),
        "settings": dict(vars(meta.settings)),
        "content_hash": meta.content_hash.hex(),
        "sections": {"container": len(data) - sum(sizes.values()), **sizes},
    }


def _read_meta(sections: dict[str, Section]) -> Meta:
    meta = _guarded(sections["META"], unpack_meta)
    limit = min(MAX_ANCHORS, len(sections["ANCH"].data) * octree.MAX_POINTS_A_BYTE)
    if meta.anchors > limit:
        raise sections["META"].error(f"{meta.anchors} anchors declared, at most {limit} can follow")
    return meta


def _decode_rows(section: Section, meta: Meta, channels: int) -> npt.NDArray[np.int32]:
    return _guarded(section, runlength.decode, meta.anchors, channels)


def _guarded(section: Section, reader: Callable[..., _T], *arguments: int) -> _T:
    """``reader(data, *arguments)``, with its ValueError as a CodecError that names the section."""
    try:
        return reader(section.data, *arguments)
    except ValueError as error:
        raise section.error(str(error)) from error
