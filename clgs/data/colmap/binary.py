"""Reads the binary form of a COLMAP model: cameras, images, points3D (.bin).

Every declared count is compared with the bytes that remain before it sizes anything, and every
number is checked. Rigs and frames are checked only: COLMAP writes the pose of each image to
images.bin, too.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from clgs.data.colmap.records import (
    MAX_COORDINATE,
    PARAMETERS,
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    check_name,
    check_pose,
    sorted_points,
)
from clgs.errors import DataError
from clgs.files import in_any_case

MAX_NAME_BYTES = 1024
LEAST_IMAGE_BYTES = 73
_MODELS = list(PARAMETERS)
_POINT = np.dtype([("number", "<u8"), ("position", "<f8", 3), ("color", "u1", 3)])
_POINT_BYTES = 51
"""Bytes of a point without its track: those of _POINT, its error, and the track's length."""


def read_binary(folder: Path) -> ColmapModel:
    """The model in ``folder``, which holds all three files.

    Raises:
        DataError: names file, byte offset and what is wrong.
    """
    file = _File(folder / "cameras.bin")
    cameras: dict[int, ColmapCamera] = {}
    for _ in file.records(24):
        number, model, width, height = file.take("<IIQQ")
        if model >= len(_MODELS):
            file.fail(
                f"camera model {model} is unknown (undistort with COLMAP's image_undistorter)"
            )
        name = _MODELS[model]
        params = file.take(f"<{len(PARAMETERS[name].split())}d")
        if number in cameras:
            file.fail(f"camera {number} occurs twice")
        cameras[number] = ColmapCamera(name, width, height, params)
        cameras[number].check(file.fail)
    images = _read_images(_File(folder / "images.bin"), cameras)
    position, color = _read_points(_File(folder / "points3D.bin"))
    if (rigs := in_any_case(folder / "rigs.bin")).is_file():
        _check_rigs(_File(rigs))
    if (frames := in_any_case(folder / "frames.bin")).is_file():
        file = _File(frames)
        for _ in file.records(68):
            file.take("<II")
            file.pose()
            file.skip(file.take("<I")[0], 16)
    return ColmapModel(images, position, color)


class _File:
    """The bytes of one file, and the place that is read next."""

    def __init__(self, path: Path) -> None:
        self.path = in_any_case(path)
        self.data = self.path.read_bytes()
        self.at = 0

    def fail(self, problem: str) -> NoReturn:
        raise DataError(f"{self.path}: byte {self.at}: {problem}; export the model again")

    def take(self, layout: str) -> tuple[Any, ...]:
        """The numbers that ``layout`` describes, as of the module struct."""
        size = struct.calcsize(layout)
        if size > len(self.data) - self.at:
            self.fail("truncated")
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def bounded(self, count: int, size: int) -> int:
        """``count``, if that number of records of at least ``size`` bytes can follow."""
        if count > (len(self.data) - self.at) // size:
            self.fail(f"{count} records are declared but the file ends before")
        return count

    def skip(self, count: int, size: int) -> None:
        """Pass over ``count`` records of ``size`` bytes."""
        self.at += self.bounded(count, size) * size

    def records(self, size: int) -> Iterator[int]:
        """Count the records of the whole file; each has at least ``size`` bytes."""
        yield from range(self.bounded(self.take("<Q")[0], size))
        if self.at != len(self.data):
            self.fail("the file does not end with the last record")

    def pose(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """A quaternion and a translation."""
        values = self.take("<7d")
        check_pose(values[:4], values[4:], self.fail)
        return values[:4], values[4:]

    def name(self) -> str:
        """A zero-terminated relative path."""
        end = self.data.find(b"\0", self.at, self.at + MAX_NAME_BYTES)
        if end < 0:
            self.fail("image name has no end")
        try:
            name = self.data[self.at : end].decode()
        except UnicodeDecodeError:
            self.fail("image name is not UTF-8")
        check_name(name, self.fail)
        self.at = end + 1
        return name


def _read_images(file: _File, cameras: dict[int, ColmapCamera]) -> list[ColmapImage]:
    images: dict[int, ColmapImage] = {}
    for _ in file.records(LEAST_IMAGE_BYTES):
        (number,) = file.take("<I")
        quaternion, translation = file.pose()
        (camera,) = file.take("<I")
        if camera not in cameras:
            file.fail(f"camera {camera} is not in cameras.bin")
        if number in images:
            file.fail(f"image {number} occurs twice")
        images[number] = ColmapImage(file.name(), cameras[camera], quaternion, translation)
        file.skip(file.take("<Q")[0], 24)
    return list(images.values())


def _read_points(file: _File) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    starts, track_length = [], struct.Struct("<Q").unpack_from
    for _ in file.records(_POINT_BYTES):
        starts.append(file.at)
        end = file.at + _POINT_BYTES
        if end > len(file.data):
            file.fail("truncated")
        file.at = end + 8 * track_length(file.data, end - 8)[0]
    places = np.array(starts, np.int64)[:, None] + np.arange(_POINT.itemsize)
    rows = np.frombuffer(file.data, np.uint8)[places].view(_POINT).reshape(-1)
    bad = ~(np.abs(rows["position"]) <= MAX_COORDINATE).all(axis=1)
    if bad.any():
        file.at = starts[int(np.argmax(bad))]
        file.fail(f"point is not finite, or beyond {MAX_COORDINATE:g}")
    return sorted_points(rows["number"], rows["position"], rows["color"], file.fail)


def _check_rigs(file: _File) -> None:
    for _ in file.records(8):
        _, sensors = file.take("<II")
        if sensors:
            file.take("<iI")
        for _ in range(file.bounded(max(0, sensors - 1), 9)):
            file.take("<iI")
            if file.take("<B")[0]:
                file.pose()
