"""Walks a binary COLMAP model by arithmetic before pycolmap reads it.

pycolmap allocates by declared counts, reads past truncated ends and accepts NaN poses and names
with '..'; here every count is compared with the bytes that remain, and every number is checked.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NoReturn

from clgs.errors import DataError

MAX_COORDINATE = 1e12
MAX_IMAGE_SIDE = 1_000_000
MAX_NAME_BYTES = 1024
PARAMETERS = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12, 11: 16}
"""Number of parameters of each COLMAP camera model id of the file format."""


def check_binary_model(folder: Path) -> None:
    """Check cameras, images, points3D and, if present, rigs and frames (.bin).

    Raises:
        DataError: naming file, byte offset and what is wrong.
    """
    for name, walk in _WALKS.items():
        path = folder / f"{name}.bin"
        if path.is_file():
            _check(path, walk)


def _check(path: Path, walk: Callable[[_Reader], None]) -> None:
    reader = _Reader(path)
    count = reader.take("<Q")[0]
    for _ in range(reader.bounded(count, 1)):
        walk(reader)
    if reader.at != len(reader.data):
        reader.fail("bytes follow the last record")


class _Reader:
    """A cursor over the bytes of one file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = path.read_bytes()
        self.at = 0

    def fail(self, problem: str) -> NoReturn:
        raise DataError(f"{self.path}: byte {self.at}: {problem}; export the model again")

    def take(self, layout: str) -> tuple[int, ...]:
        """Integers in little-endian ``layout``."""
        size = struct.calcsize(layout)
        if size > len(self.data) - self.at:
            self.fail("truncated")
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def reals(self, count: int, what: str) -> tuple[float, ...]:
        """``count`` finite doubles of sensible size."""
        values = self.take(f"<{count}d")
        if not all(abs(value) <= MAX_COORDINATE for value in values):
            self.fail(f"{what} is not finite, or beyond {MAX_COORDINATE:g}")
        return values

    def bounded(self, count: int, size: int) -> int:
        """``count``, if that many records of at least ``size`` bytes can follow."""
        if count > (len(self.data) - self.at) // size:
            self.fail(f"{count} records are declared but the file ends before")
        return count

    def skip(self, count: int, size: int) -> None:
        """Pass over ``count`` records of ``size`` bytes."""
        self.at += self.bounded(count, size) * size

    def pose(self) -> None:
        """A quaternion and a translation."""
        if not is_unit(self.reals(7, "pose")[:4]):
            self.fail("rotation quaternion is not of unit length")

    def name(self) -> None:
        """A zero-terminated relative path."""
        end = self.data.find(b"\0", self.at, self.at + MAX_NAME_BYTES)
        if end < 0:
            self.fail("image name has no end")
        try:
            check_name(self.data[self.at : end].decode(), f"{self.path}: byte {self.at}")
        except UnicodeDecodeError:
            self.fail("image name is not UTF-8")
        self.at = end + 1


def is_unit(quaternion: Iterable[float]) -> bool:
    """Whether its length is 1 but for rounding; pycolmap does not scale what it reads."""
    return math.isclose(math.hypot(*quaternion), 1.0, abs_tol=0.01)


def check_name(name: str, source: str) -> None:
    """Raise DataError if an image name is empty, absolute or leads upwards."""
    parts = name.replace("\\", "/").split("/")
    if not name or not parts[0] or ".." in parts or ":" in parts[0]:
        raise DataError(f"{source}: image name {name[:80]!r} must stay inside the images folder")


def _camera(reader: _Reader) -> None:
    _, model, width, height = reader.take("<IiQQ")
    if not (1 <= width <= MAX_IMAGE_SIDE and 1 <= height <= MAX_IMAGE_SIDE):
        reader.fail(f"camera size {width}x{height} is impossible")
    if model not in PARAMETERS:
        reader.fail(f"camera model {model} is unknown (undistort with COLMAP's image_undistorter)")
    if not reader.reals(PARAMETERS[model], "camera parameter")[0] > 0:
        reader.fail("focal length is not positive")


def _image(reader: _Reader) -> None:
    reader.take("<I")
    reader.pose()
    reader.take("<I")
    reader.name()
    reader.skip(reader.take("<Q")[0], 24)


def _point(reader: _Reader) -> None:
    reader.take("<Q")
    reader.reals(3, "point")
    reader.take("<3B")
    reader.take("<Q")  # the error: not read, any value will do
    reader.skip(reader.take("<Q")[0], 8)


def _rig(reader: _Reader) -> None:
    _, sensors = reader.take("<II")
    if sensors:
        reader.take("<iI")
    for _ in range(reader.bounded(max(0, sensors - 1), 9)):
        reader.take("<iI")
        if reader.take("<B")[0]:
            reader.pose()


def _frame(reader: _Reader) -> None:
    reader.take("<II")
    reader.pose()
    reader.skip(reader.take("<I")[0], 16)


_WALKS: dict[str, Callable[[_Reader], None]] = {
    "cameras": _camera,
    "images": _image,
    "points3D": _point,
    "rigs": _rig,
    "frames": _frame,
}
