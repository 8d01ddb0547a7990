"""Equirectangular photos cut into pinhole views, which structure from motion and training read.

Column and row of such a photo are longitude and latitude; its middle is ahead. Each view shows VIEW
degrees across and down, and has the photo's resolution in its middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.images import Pixels, open_image
from clgs.data.lens import resample
from clgs.errors import DataError

VIEW = 90.0
DIRECTIONS = (
    *((60.0 * number, 0.0) for number in range(6)),
    *((30.0 + 120.0 * number, 45.0) for number in range(3)),
    *((90.0 + 120.0 * number, -45.0) for number in range(3)),
)
"""Degrees to the right and up of each view. Level neighbours share a third of what they show."""

FOCAL_35MM = 18
"""The focal length of VIEW on film of 35 mm, which is 36 mm wide."""

MARKS = b"ProjectionType", b"equirectangular"
"""What the XMP data of a photo hold if it says what it is (Google's Photo Sphere, GPano)."""


def is_marked(path: Path) -> bool:
    """Whether a photo is twice as wide as high, and its XMP data call it equirectangular.

    Raises:
        DataError: it cannot be read.
    """
    with open_image(path) as picture:
        if picture.width != 2 * picture.height:
            return False
        known = (picture.info.get(name, b"") for name in ("xmp", "XML:com.adobe.xmp"))
        data = b"".join(one.encode() if isinstance(one, str) else bytes(one) for one in known)
        return all(mark in data for mark in MARKS)


def check_shape(path: Path, size: tuple[int, int]) -> None:
    """Raise DataError unless ``size`` (width, height) is that of an equirectangular photo."""
    if size[0] != 2 * size[1]:
        raise DataError(
            f"{path}: is {size[0]}x{size[1]}, and an equirectangular photo is twice as wide as "
            "high; leave --equirectangular out, or this photo"
        )


def view_size(width: int) -> int:
    """Pixels of the edge of a view of a photo that is ``width`` pixels wide."""
    return max(1, round(width / np.pi))


def view_name(number: int, name: str) -> str:
    """The name of a view: those of one direction follow each other, in the order of the photos."""
    return f"view{number:02}_{name}"


def cut(pixels: Pixels) -> Iterator[Pixels]:
    """The views of a photo in the order of DIRECTIONS, bilinear; alpha as color."""
    channels = pixels.color
    if pixels.alpha is not None:
        channels = np.dstack([channels, pixels.alpha])
    height, width = channels.shape[:2]
    around = np.concatenate([channels[:, -1:], channels, channels[:, :1]], axis=1)
    size = view_size(width)
    for yaw, pitch in DIRECTIONS:
        longitude, latitude = _angles(size, yaw, pitch)
        column = np.mod(longitude / (2 * np.pi) + 0.5, 1.0) * width + 0.5
        row = np.clip((0.5 - latitude / np.pi) * height - 0.5, 0, height - 1)
        corner = np.minimum(column.astype(np.int32), width), row.astype(np.int32)
        corner = corner[0], np.minimum(corner[1], max(height - 2, 0))
        index = corner[1] * np.int32(width + 2) + corner[0]
        weight = np.stack([column - corner[0], row - corner[1]], axis=1).astype(np.float32)
        view = resample(around, index, weight).reshape(size, size, -1)
        alpha = None if pixels.alpha is None else np.ascontiguousarray(view[..., 3])
        yield Pixels(np.ascontiguousarray(view[..., :3]), alpha)


def _angles(
    size: int, yaw: float, pitch: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Longitude and latitude (N,) in radians of a view's pixels, row by row."""
    grid = (np.arange(size) + 0.5) / size * 2 - 1
    grid *= np.tan(np.radians(VIEW / 2))
    right, down = (axis.ravel() for axis in np.meshgrid(grid, grid))
    sin, cos = np.sin(np.radians(pitch)), np.cos(np.radians(pitch))
    ahead, up = cos + sin * down, sin - cos * down
    return np.arctan2(right, ahead) + np.radians(yaw), np.arctan2(up, np.hypot(right, ahead))
