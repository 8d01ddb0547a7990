"""What every loader hands on: posed photos that exist, in the data's own world units."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import numpy.typing as npt

from clgs.data.lens import Lens
from clgs.errors import DataError

ASPECT_TOLERANCE = 1.5
"""Pixels by which an image may differ from its declared size scaled evenly (sizes are rounded)."""

LONGEST_NAME, LONGEST_PATH = 255, 4096
"""Bytes, of Linux; others allow as much or less."""


@dataclass(frozen=True)
class Photo:
    """One photo with its pose: x_cam = rotation @ x_world + translation, OpenCV axes.

    name: unique, relative to the data set, forward slashes; lens: for the pixels in the file;
    rotation (3, 3), translation (3,) float64 in the data's world units; mask: the file that says
    which pixels are of use, if there is one.
    """

    name: str
    path: Path
    lens: Lens
    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    mask: Path | None = None

    @property
    def centre(self) -> npt.NDArray[np.float64]:
        """Camera centre (3,) float64 in world units."""
        return np.asarray(-self.rotation.T @ self.translation)


@dataclass
class PhotoSet:
    """A data set before its images are decoded.

    kind: "blender", "transforms" or "colmap"; missing: names of photos that are not on disk;
    points (P, 3) float64 world units and point_colors (P, 3) uint8, or None if the set has none;
    points_file: the file that it names for them, which is not read yet.
    """

    kind: str
    train: list[Photo]
    test: list[Photo]
    missing: list[str] = field(default_factory=list)
    points: npt.NDArray[np.float64] | None = None
    point_colors: npt.NDArray[np.uint8] | None = None
    points_file: Path | None = None


def hold_out(photos: list[Photo], interval: int = 8) -> tuple[list[Photo], list[Photo]]:
    """(train, test): of the photos sorted by name, number 0, interval, 2 interval ... are test."""
    ordered = sorted(photos, key=lambda photo: photo.name)
    train = [photo for i, photo in enumerate(ordered) if i % interval]
    return train, ordered[::interval]


def fit_lens(lens: Lens, size: tuple[int, int], path: Path) -> Lens:
    """The lens on an image's actual (width, height).

    Raises:
        DataError: the image has another aspect ratio than the intrinsics.
    """
    width, height = size
    if (width, height) == (lens.width, lens.height):
        return lens
    scale = max(width / lens.width, height / lens.height)
    excess = max(abs(lens.width * scale - width), abs(lens.height * scale - height))
    if not excess <= ASPECT_TOLERANCE:
        raise DataError(
            f"{path}: image is {width}x{height} but its intrinsics are for "
            f"{lens.width}x{lens.height}; crop neither, or correct w, h and the intrinsics"
        )
    return lens.resized(width, height)


def nameable(path: Path) -> bool:
    """Whether common file systems can have such a file."""
    try:
        lengths = [len(os.fsencode(part)) for part in path.parts]
    except UnicodeEncodeError:
        return False
    return max(lengths) <= LONGEST_NAME and sum(lengths) + len(lengths) < LONGEST_PATH


def inside(root: Path, name: str, source: str) -> Path:
    """The path of ``name`` below ``root``.

    Raises:
        DataError: empty, absolute, with '..' or NUL, no name that a file can have, or a link that
            leads out of ``root``.
    """
    portable = name.replace("\\", "/")
    relative = PurePosixPath(portable)
    absolute = relative.is_absolute() or bool(PureWindowsPath(name).drive)
    if not relative.parts or absolute or ".." in relative.parts or "\0" in name:
        raise DataError(f"{source}: path {name[:80]!r} must stay inside the data folder")
    path = root / relative
    if not nameable(path):
        raise DataError(
            f"{source}: path {name[:80]!r} cannot be a file's name; shorten or correct it"
        )
    if not path.resolve().is_relative_to(root.resolve()):
        raise DataError(f"{source}: path {name[:80]!r} is a link out of the data folder; copy it")
    return path


def rigid(matrix: npt.NDArray[np.float64], source: str) -> npt.NDArray[np.float64]:
    """The rotation (3, 3) nearest to a nearly orthonormal ``matrix``.

    Raises:
        DataError: not finite, scaled, sheared or mirrored.
    """
    if not np.all(np.isfinite(matrix)):
        raise DataError(f"{source} is not finite; recompute the poses")
    product = matrix @ matrix.T
    if not (np.abs(product - np.eye(3)).max() <= 1e-2 and np.linalg.det(matrix) > 0):
        raise DataError(f"{source} is not a rotation; recompute the poses")
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
