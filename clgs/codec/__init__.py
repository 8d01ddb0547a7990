"""The codec: scenes as .clgs files, and integer arrays as bytes; works without OpenCL.

- ``encode_positions(positions)`` / ``decode_positions(data)``: unique voxels (N, 3)
- ``encode_attributes(values, level)`` / ``decode_attributes(data)``: rows (N, channels)
- ``morton_order(positions)``: the order in which positions come back
- ``scene_encoder.encode(scene)`` / ``scene_decoder.decode(data)``: whole scenes
"""

from clgs.codec.streams import (
    decode_attributes,
    decode_positions,
    encode_attributes,
    encode_positions,
    morton_order,
)

__all__ = [
    "decode_attributes",
    "decode_positions",
    "encode_attributes",
    "encode_positions",
    "morton_order",
]
