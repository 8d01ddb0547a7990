"""Section GEOR: what the world of a scene is (codec_c/FORMAT.md on GEOR)."""

from __future__ import annotations

import struct

from clgs.scene.world import LOCAL, Place, is_world

_GEOR = struct.Struct("<II3d")


def pack_geor(frame: float, place: Place) -> bytes:
    """The bytes of the section."""
    return _GEOR.pack(int(frame), 0, *place)


def unpack_geor(data: bytes | memoryview) -> tuple[int, Place]:
    """Read the frame and the place.

    Raises:
        ValueError: wrong size, or a number out of range.
    """
    if len(data) != _GEOR.size:
        raise ValueError(f"{len(data)} bytes instead of {_GEOR.size}")
    frame, zero, *place = _GEOR.unpack(data)
    found = place[0], place[1], place[2]
    if frame == LOCAL or zero or not is_world(frame, found):
        raise ValueError(f"frame {frame} with place {found} is out of range")
    return frame, found
