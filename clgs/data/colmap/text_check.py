"""Checks a text COLMAP model line by line.

pycolmap takes a zero quaternion for no rotation, and its error messages name C++ code.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from clgs.data.colmap.binary_check import MAX_COORDINATE, PARAMETERS, is_unit
from clgs.errors import DataError

MODELS = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
]
"""By the number of the model in binary files."""

_CAMERA = ("CAMERA_ID", "MODEL", "WIDTH", "HEIGHT")
_IMAGE = ("IMAGE_ID", "QW", "QX", "QY", "QZ", "TX", "TY", "TZ", "CAMERA_ID", "NAME")
_POINT = ("POINT3D_ID", "X", "Y", "Z", "R", "G", "B", "ERROR")
_FRAME = ("FRAME_ID", "RIG_ID", "QW", "QX", "QY", "QZ", "TX", "TY", "TZ")
_RIG = ("RIG_ID", "NUM_SENSORS", "REF_SENSOR_TYPE", "REF_SENSOR_ID")
_SENSOR = ("SENSOR_TYPE", "SENSOR_ID", "HAS_POSE", "QW", "QX", "QY", "QZ", "TX", "TY", "TZ")
_BINARY = "export the model as .bin, or rename the photo"

_UNPOSED = 3
"""Fields of a sensor without a pose."""

_WHOLE = {"CAMERA_ID", "IMAGE_ID", "POINT3D_ID", "WIDTH", "HEIGHT", "R", "G", "B"}
_TEXT = {"MODEL", "NAME", "REF_SENSOR_TYPE", "SENSOR_TYPE"}


def check_text_poses(folder: Path) -> None:
    """Raise DataError, naming file, line and field, if a pose is no rotation and translation.

    Args:
        folder: holds images.txt and, if the model has rigs, frames.txt and rigs.txt.
    """
    lines = _every_line(folder / "images.txt")
    for line in lines:
        if _counts(line):
            line.check_pose(_IMAGE)
            if len(line.words) > len(_IMAGE):
                name = " ".join(line.words[len(_IMAGE) - 1 :])[:80]
                line.fail(f"NAME {name!r} has a blank, at which readers cut it", _BINARY)
            next(lines, line.after()).check_points()
    for line in _lines(folder / "frames.txt"):
        line.check_pose(_FRAME)
    for line in _lines(folder / "rigs.txt"):
        _rig(line)


def explain_text_model(folder: Path) -> None:
    """Raise DataError naming file, line and field of the first fault; return if there is none.

    Args:
        folder: holds cameras.txt, images.txt and points3D.txt.
    """
    cameras = {_camera(line) for line in _lines(folder / "cameras.txt")}
    images = dict(_images(folder / "images.txt", cameras))
    for line in _lines(folder / "points3D.txt"):
        _point(line, images)


@dataclass(frozen=True)
class _Line:
    """One line of a file, and its file and number."""

    path: Path
    number: int
    words: list[str]

    def fail(self, problem: str, remedy: str = "export the model again") -> NoReturn:
        raise DataError(f"{self.path}: line {self.number}: {problem}; {remedy}")

    def field(self, names: tuple[str, ...], name: str) -> int:
        """The whole number in field ``name``."""
        return int(self.words[names.index(name)])

    def check(self, names: tuple[str, ...]) -> list[str]:
        """Refuse fields that are missing or of the wrong kind; the words after them."""
        for index, name in enumerate(names):
            if index >= len(self.words):
                self.fail(f"{name} is missing")
            self.check_word(name, self.words[index])
        return self.words[len(names) :]

    def after(self) -> _Line:
        """The line that a file lacks if it ends here."""
        return _Line(self.path, self.number + 1, [])

    def check_points(self) -> None:
        """Refuse what cannot be the image points of the line before."""
        if len(self.words) % 3:
            self.fail(
                "POINTS2D are not of three numbers each; the line of an image without any is empty"
            )
        if self.words:
            self.check_word("POINT3D_ID", self.words[-1])

    def check_pose(self, names: tuple[str, ...]) -> None:
        """Refuse fields QW to TZ that are not finite, or a quaternion that is not of length 1."""
        first = names.index("QW")
        for name, word in zip(names[first : first + 7], self.words[first:], strict=False):
            self.check_word(name, word)
        if len(self.words) < first + 7:
            self.fail(f"{names[len(self.words)]} is missing")
        quaternion = self.words[first : first + 4]
        if not is_unit(map(float, quaternion)):
            self.fail("QW, QX, QY, QZ are not of length 1")
        if any(not abs(float(word)) <= MAX_COORDINATE for word in self.words[first : first + 7]):
            self.fail(f"TX, TY, TZ are larger than {MAX_COORDINATE:g}")

    def check_word(self, name: str, word: str) -> None:
        """Refuse a ``word`` that cannot be the field ``name``."""
        if name in _WHOLE and not _is_whole(word):
            self.fail(f"{name} is {word[:40]!r}, not a whole number")
        if name not in _WHOLE | _TEXT and not _is_finite(word):
            self.fail(f"{name} is {word[:40]!r}, not a finite number")


def _every_line(path: Path) -> Iterator[_Line]:
    """None if there is no such file: models without rigs lack two."""
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, text in enumerate(file, 1):
            yield _Line(path, number, text.split())


def _lines(path: Path) -> Iterator[_Line]:
    """Without comments and empty lines."""
    return (line for line in _every_line(path) if _counts(line))


def _counts(line: _Line) -> bool:
    return bool(line.words) and not line.words[0].startswith("#")


def _camera(line: _Line) -> int:
    """The camera's number."""
    parameters = line.check(_CAMERA)
    model = line.words[_CAMERA.index("MODEL")]
    if model not in MODELS:
        line.fail(f"MODEL {model[:40]!r} is unknown (undistort with COLMAP's image_undistorter)")
    wanted = PARAMETERS[MODELS.index(model)]
    if len(parameters) != wanted:
        line.fail(f"PARAMS are {len(parameters)} numbers, {model} has {wanted}")
    for word in parameters:
        line.check_word("PARAMS", word)
    return line.field(_CAMERA, "CAMERA_ID")


def _images(path: Path, cameras: set[int]) -> Iterator[tuple[int, int]]:
    """Number and count of image points of each image, whose lines come in pairs."""
    lines = _every_line(path)
    for line in lines:
        if not _counts(line):
            continue
        line.check(_IMAGE)
        camera = line.field(_IMAGE, "CAMERA_ID")
        if camera not in cameras:
            line.fail(f"CAMERA_ID {camera} is not in cameras.txt")
        points = next(lines, line.after())
        points.check_points()
        for index, word in enumerate(points.words):
            points.check_word(("X", "Y", "POINT3D_ID")[index % 3], word)
        yield line.field(_IMAGE, "IMAGE_ID"), len(points.words) // 3


def _rig(line: _Line) -> None:
    """Check the poses of the rig's sensors; the first sensor has none."""
    sensors = line.words[len(_RIG) :]
    while sensors:
        sensor = _Line(line.path, line.number, sensors)
        posed = sensors[_UNPOSED - 1 : _UNPOSED] == ["1"]
        if posed:
            sensor.check_pose(_SENSOR)
        sensors = sensors[len(_SENSOR) if posed else _UNPOSED :]


def _point(line: _Line, images: dict[int, int]) -> None:
    track = line.check(_POINT)
    if len(track) % 2:
        line.fail("TRACK is not of two numbers each")
    for image, index in zip(track[::2], track[1::2], strict=True):
        if not (_is_whole(image) and _is_whole(index)):
            line.fail(f"TRACK has {image[:40]!r}, {index[:40]!r}, not whole numbers")
        if not 0 <= int(index) < images.get(int(image), 0):
            line.fail(f"TRACK: images.txt has no point {int(index)} of image {int(image)}")


def _is_whole(word: str) -> bool:
    return len(word) < 20 and word.removeprefix("-").isdecimal()


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
