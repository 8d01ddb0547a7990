"""Section LAYR: which chunks are a layer, and the hash of each (codec_c/FORMAT.md)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from clgs.options import MAX_LAYERS

_COUNT = struct.Struct("<I")
_LAYER = struct.Struct("<IQ")


@dataclass(frozen=True)
class Layer:
    """Chunks that follow those of the layer before; ``content_hash``: as META's, of this layer."""

    chunks: int
    content_hash: bytes


def pack_layers(layers: list[Layer]) -> bytes:
    """Section LAYR."""
    rows = (
        _LAYER.pack(layer.chunks, int.from_bytes(layer.content_hash, "little")) for layer in layers
    )
    return _COUNT.pack(len(layers)) + b"".join(rows)


def unpack_layers(data: bytes | memoryview, chunks: int) -> list[Layer]:
    """The layers of a file of ``chunks`` chunks.

    Raises:
        ValueError: another length, a number out of range, or chunks that do not add up.
    """
    count = _COUNT.unpack_from(data)[0] if len(data) >= _COUNT.size else 0
    if not 1 <= count <= MAX_LAYERS or len(data) != _COUNT.size + count * _LAYER.size:
        raise ValueError(f"{len(data)} bytes do not hold 1 to {MAX_LAYERS} layers")
    rows = _LAYER.iter_unpack(data[_COUNT.size :])
    layers = [Layer(number, content.to_bytes(8, "little")) for number, content in rows]
    if min(layer.chunks for layer in layers) < 1:
        raise ValueError("a layer has no chunks")
    if sum(layer.chunks for layer in layers) != chunks:
        raise ValueError(f"the layers do not have {chunks} chunks in all")
    return layers
