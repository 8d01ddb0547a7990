"""Reads the files of a COLMAP model: cameras, images, points3D, as text (.txt) or binary (.bin).

Every count that a binary file declares is compared with the bytes that remain before it sizes
anything, and every number is checked. Rigs and frames are checked only: COLMAP writes the pose of
each image to images.txt or images.bin, too.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from clgs.arguments import plain_float
from clgs.data.colmap_records import (
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

_POSE = ("QW", "QX", "QY", "QZ", "TX", "TY", "TZ")
_CAMERA = ("CAMERA_ID", "MODEL", "WIDTH", "HEIGHT")
_IMAGE = ("IMAGE_ID", *_POSE, "CAMERA_ID", "NAME")
_TEXT_POINT = ("POINT3D_ID", "X", "Y", "Z", "R", "G", "B", "ERROR")

_WORD = re.compile(r"\S+", re.ASCII)
"""Blanks of other scripts are part of a name."""

_BEFORE_SENSORS, _UNPOSED = 4, 3
"""Fields of a rig before its sensors, and those of a sensor without a pose."""

_WHOLE = {"CAMERA_ID", "IMAGE_ID", "POINT3D_ID", "WIDTH", "HEIGHT", "R", "G", "B"}
_TEXT = {"MODEL", "NAME"}


def read_text(folder: Path) -> ColmapModel:
    """The model in ``folder``, which holds all three files.

    Raises:
        DataError: names file, line and field.
    """
    names = "cameras", "images", "frames", "rigs", "points3D"
    files = {name: in_any_case(folder / f"{name}.txt") for name in names}
    cameras = _read_cameras(files["cameras"])
    images, observations = _read_text_images(files["images"], cameras)
    for line in _lines(files["frames"]):
        line.pose(2)
    for line in _lines(files["rigs"]):
        # check the poses of the rig's sensors; the first sensor has none
        at = _BEFORE_SENSORS
        while at < len(line.words):
            at += _UNPOSED
            if line.words[at - 1 : at] == ["1"]:
                line.pose(at)
                at += len(_POSE)
    position, color = _read_text_points(files["points3D"], observations)
    return ColmapModel(images, position, color)


@dataclass(frozen=True)
class _Line:
    """The words of one line of a file."""

    path: Path
    number: int
    words: list[str]

    def fail(self, problem: str, remedy: str = "export the model again") -> NoReturn:
        raise DataError(f"{self.path}: line {self.number}: {problem}; {remedy}")

    @property
    def counts(self) -> bool:
        """Whether it is neither empty nor a comment."""
        return bool(self.words) and not self.words[0].startswith("#")

    def check(self, names: tuple[str, ...], first: int = 0) -> list[str]:
        """The words after the fields ``names``, each of which is there and of its kind.

        The first field is word ``first``.
        """
        for index, name in enumerate(names, first):
            if index >= len(self.words):
                self.fail(f"{name} is missing")
            self.check_word(name, self.words[index])
        return self.words[first + len(names) :]

    def check_word(self, name: str, word: str) -> None:
        """Refuse a ``word`` that cannot be the field ``name``."""
        if name in _WHOLE:
            if not _is_whole(word):
                self.fail(f"{name} is {word[:40]!r}, not a whole number")
            if name in ("R", "G", "B") and not 0 <= int(word) <= 255:
                self.fail(f"{name} is {word}, not 0 to 255")
        elif name not in _TEXT and not _is_finite(word):
            self.fail(f"{name} is {word[:40]!r}, not a finite number")

    def pose(self, first: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The quaternion and the translation from word ``first`` on."""
        self.check(_POSE, first)
        values = tuple(map(float, self.words[first : first + len(_POSE)]))
        check_pose(values[:4], values[4:], self.fail)
        return values[:4], values[4:]

    def observations(self) -> int:
        """The number of image points in the second line of an image."""
        if len(self.words) % 3:
            self.fail(
                "POINTS2D are not of three numbers each; the line of an image without any is empty"
            )
        if self.words:
            self.check_word("POINT3D_ID", self.words[-1])
        return len(self.words) // 3


def _every_line(path: Path) -> Iterator[_Line]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, text in enumerate(file, 1):
            yield _Line(path, number, _WORD.findall(text))


def _lines(path: Path) -> Iterator[_Line]:
    """The lines without comments and empty ones; none if there is no file."""
    return filter(lambda line: line.counts, _every_line(path) if path.is_file() else iter(()))


def _read_cameras(path: Path) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    for line in _lines(path):
        words = line.check(_CAMERA)
        number, model, width, height = line.words[: len(_CAMERA)]
        if model not in PARAMETERS:
            line.fail(
                f"MODEL {model[:40]!r} is unknown (undistort with COLMAP's image_undistorter)"
            )
        wanted = len(PARAMETERS[model].split())
        if len(words) != wanted:
            line.fail(f"PARAMS are {len(words)} numbers, {model} has {wanted}")
        for word in words:
            line.check_word("PARAMS", word)
        if int(number) in cameras:
            line.fail(f"CAMERA_ID {number} occurs twice")
        camera = ColmapCamera(model, int(width), int(height), tuple(map(float, words)))
        camera.check(line.fail)
        cameras[int(number)] = camera
    return cameras


def _read_text_images(
    path: Path, cameras: dict[int, ColmapCamera]
) -> tuple[list[ColmapImage], dict[int, int]]:
    """The images, and the number of image points of each by its id."""
    images: list[ColmapImage] = []
    observations: dict[int, int] = {}
    lines = _every_line(path)
    for line in lines:
        if not line.counts:
            continue
        quaternion, translation = line.pose(1)
        if more := line.check(_IMAGE):
            name = " ".join([line.words[len(_IMAGE) - 1], *more])[:80]
            remedy = "export the model as .bin, or rename the photo"
            line.fail(f"NAME {name!r} has a blank, at which readers cut it", remedy)
        number, camera, name = int(line.words[0]), int(line.words[-2]), line.words[-1]
        if camera not in cameras:
            line.fail(f"CAMERA_ID {camera} is not in cameras.txt")
        if number in observations:
            line.fail(f"IMAGE_ID {number} occurs twice")
        check_name(name, line.fail)
        images.append(ColmapImage(name, cameras[camera], quaternion, translation))
        missing = _Line(path, line.number + 1, [])
        observations[number] = next(lines, missing).observations()
    return images, observations


def _read_text_points(
    path: Path, observations: dict[int, int]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    numbers, positions, colors = [], [], []
    line, listed = _Line(path, 0, []), any(observations.values())  # some programs leave them out
    for line in _lines(path):
        track = line.check(_TEXT_POINT)
        if len(track) % 2:
            line.fail("TRACK is not of two numbers each")
        for image, index in zip(track[::2], track[1::2], strict=True):
            if not (_is_whole(image) and _is_whole(index)):
                line.fail(f"TRACK has {image[:40]!r}, {index[:40]!r}, not whole numbers")
            if listed and not 0 <= int(index) < observations.get(int(image), 0):
                line.fail(f"TRACK: images.txt has no point {int(index)} of image {int(image)}")
        numbers.append(int(line.words[0]))
        positions.append([float(word) for word in line.words[1:4]])
        colors.append([int(word) for word in line.words[4:7]])
    return sorted_points(
        np.array(numbers, np.int64),
        np.array(positions, np.float64).reshape(-1, 3),
        np.array(colors, np.uint8).reshape(-1, 3),
        line.fail,
    )


def _is_whole(word: str) -> bool:
    return len(word) < 19 and word.isascii() and word.removeprefix("-").isdecimal()


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(plain_float(word))
    except ValueError:
        return False


MAX_NAME_BYTES = 1024
LEAST_IMAGE_BYTES = 73
_MODELS = list(PARAMETERS)
_BINARY_POINT = np.dtype([("number", "<u8"), ("position", "<f8", 3), ("color", "u1", 3)])
_POINT_BYTES = 51
"""Bytes of a point without its track: those of _BINARY_POINT, its error, and the track's length."""


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
    images = _read_binary_images(_File(folder / "images.bin"), cameras)
    position, color = _read_binary_points(_File(folder / "points3D.bin"))
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


def _read_binary_images(file: _File, cameras: dict[int, ColmapCamera]) -> list[ColmapImage]:
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


def _read_binary_points(file: _File) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    starts, track_length = [], struct.Struct("<Q").unpack_from
    for _ in file.records(_POINT_BYTES):
        starts.append(file.at)
        end = file.at + _POINT_BYTES
        if end > len(file.data):
            file.fail("truncated")
        file.at = end + 8 * track_length(file.data, end - 8)[0]
    places = np.array(starts, np.int64)[:, None] + np.arange(_BINARY_POINT.itemsize)
    rows = np.frombuffer(file.data, np.uint8)[places].view(_BINARY_POINT).reshape(-1)
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
