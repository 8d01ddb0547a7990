"""The hash over what a file decodes to, which no coder has touched (FORMAT.md, part 10)."""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.scene.anchors import QuantizedAnchors


def content_arrays(
    anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]
) -> list[npt.NDArray[np.int32] | npt.NDArray[np.float32]]:
    """What is hashed, in order: position, offset, feature, scaling, weights."""
    return [anchors.position, anchors.offset, anchors.feature, anchors.scaling, weights]


def array_hash(array: npt.NDArray[np.int32] | npt.NDArray[np.float32]) -> int:
    """XXH64 of the numbers in row-major order, little-endian."""
    dtype = array.dtype.newbyteorder("<")
    return _codec.xxh64(np.ascontiguousarray(array, dtype))


def join_hashes(hashes: list[int]) -> bytes:
    """XXH64 (8 bytes, little-endian) of the arrays' hashes, each 8 bytes, little-endian."""
    return _codec.xxh64(struct.pack(f"<{len(hashes)}Q", *hashes)).to_bytes(8, "little")
