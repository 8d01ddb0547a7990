"""Section PHOT: how photos saw the scene (codec_c/FORMAT.md on PHOT)."""

from __future__ import annotations

import struct

from clgs.scene.camera import UNKNOWN, PhotoRange

_PHOT = struct.Struct("<7d")


def pack_phot(photos: PhotoRange) -> bytes:
    """The bytes of the section."""
    return _PHOT.pack(*photos)


def unpack_phot(data: bytes | memoryview) -> PhotoRange:
    """Read the bounds.

    Raises:
        ValueError: wrong size, or a number out of range.
    """
    if len(data) != _PHOT.size:
        raise ValueError(f"{len(data)} bytes instead of {_PHOT.size}")
    photos = PhotoRange(*_PHOT.unpack(data))
    if problem := photos.problem():
        raise ValueError(problem)
    if photos == UNKNOWN:
        raise ValueError("it says nothing")
    return photos
