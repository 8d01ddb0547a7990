"""Blender (Synthetic-NeRF) and nerfstudio / instant-ngp ``transforms.json`` to posed photos.

Poses are OpenGL camera-to-world matrices: y and z of the camera are flipped to get OpenCV's.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from clgs.arguments import plain_numbers
from clgs.data.lens import Lens
from clgs.data.posed_photo import (
    ListedPhoto,
    Photo,
    PhotoSet,
    hold_out,
    inside,
    locate_all,
    plain_name,
    rigid,
)
from clgs.errors import DataError
from clgs.files import in_any_case

_log = logging.getLogger(__name__)

BLENDER, BLENDER_TEST = "transforms_train.json", "transforms_test.json"
TRANSFORMS = "transforms.json"
"""The files of a Blender folder, the first of which it must have, and of nerfstudio's."""

COEFFICIENTS = {
    "SIMPLE_PINHOLE": "",
    "PINHOLE": "",
    "SIMPLE_RADIAL": "k1",
    "RADIAL": "k1 k2",
    "OPENCV": "k1 k2 k3 k4 p1 p2",
    "FULL_OPENCV": "k1 k2 k3 k4 k5 k6 p1 p2",
    "SIMPLE_RADIAL_FISHEYE": "k1",
    "RADIAL_FISHEYE": "k1 k2",
    "OPENCV_FISHEYE": "k1 k2 k3 k4",
}
"""Distortion coefficients that each ``camera_model`` reads; missing ones are zero."""

LISTED = "distortion_params"
"""Nerfstudio's field for the coefficients of OPENCV as a list; it counts more than single ones."""

DISTORTION = [*COEFFICIENTS["FULL_OPENCV"].split(), LISTED]

SIZE, CENTRE = ("w", "h"), ("cx", "cy")
LENGTHS, ANGLES = ("fl_x", "fl_y"), ("camera_angle_x", "camera_angle_y")
FOCAL = LENGTHS + ANGLES
"""Fields that belong together: all of a group are those of the frame, or those that frames share.

The coefficients of the distortion are such a group as well.
"""

FOCAL_LENGTHS = 1e-3, 1e9
"""Least and greatest, in pixels: beyond them there is no lens, and float32 overflows."""

SPLITS = "train_filenames", "test_filenames", "val_filenames"
"""Fields that list photos; those of the last two are held out."""

MAX_BYTES = 256 * 2**20
"""A larger transforms.json is refused before it is parsed."""


def read_blender(root: Path, file: Path) -> PhotoSet:
    """The split of BLENDER, which is ``file``, and BLENDER_TEST; file order kept.

    Without a test file every 8th photo is held out.

    Raises:
        DataError: names file, frame and field.
    """
    train, missing = _read_photos(root, file)
    file = in_any_case(root / BLENDER_TEST)
    if not file.is_file():
        return PhotoSet("blender", *hold_out(train), missing)
    test, more_missing = _read_photos(root, file)
    return PhotoSet("blender", train, test, missing + more_missing, split=True)


def read_transforms(root: Path, file: Path) -> PhotoSet:
    """The photos of TRANSFORMS, which is ``file``; split by train_filenames and so on if given.

    Raises:
        DataError: names file, frame and field.
    """
    document = read_json(file)
    photos, missing = _read_photos(root, file)
    found = PhotoSet("transforms", *hold_out(photos), missing)
    found.points_file = _points_file(root, document, file)
    keys = [key for key in SPLITS if key in document]
    if not keys:
        return found
    found.split = True
    lists: dict[str, set[str]] = {}
    for key in keys:
        given = document[key]
        if not (isinstance(given, list) and all(isinstance(name, str) for name in given)):
            raise DataError(f"{file}: {key} is not a list of strings; correct it")
        lists[key], strangers = _find_listed(given, photos, missing)
        if strangers:
            said = ", ".join(strangers[:8])
            _log.warning("%s: %s: no frame has the name %s", file, key, said)
        if key == "train_filenames" and not lists[key]:
            raise DataError(f"{file}: {key} lists no photo of a frame; correct or remove it")
    held_out = {name for key in SPLITS[1:] for name in lists.get(key, ())}
    tested = lists.get("test_filenames") or lists.get("val_filenames", set())
    wanted = lists.get("train_filenames")
    found.test = [photo for photo in photos if photo.name in tested]
    found.train = [photo for photo in photos if photo.name not in held_out]
    if wanted is not None:
        if both := [p.name for p in photos if p.name in wanted & held_out]:
            said = "is held out as well, so it is not trained on"
            _log.warning("%s: train_filenames: %s %s", file, ", ".join(both[:8]), said)
        if not any(document.get(key) for key in SPLITS[1:]):  # empty lists are as good as none
            found.test = [photo for photo in photos if photo.name not in wanted]
        found.train = [photo for photo in found.train if photo.name in wanted]
    return found


def _read_photos(root: Path, file: Path) -> tuple[list[Photo], list[str]]:
    document = read_json(file)
    listed = [read_frame(file, document, number) for number in range(count_frames(file, document))]
    photos, missing = locate_all(listed, root, root, str(file))
    sizes = [one.size for one in listed]
    unsized = document["frames"][sizes.index(None)] if None in sizes else document
    # Without w and h, something else of a lens may show what size of photos it is for.
    if None in sizes and not {*CENTRE, *ANGLES} & {*document, *unsized}:
        lens = photos[0].lens
        view = 2 * np.degrees(np.arctan(lens.width / (2 * lens.fx)))
        _log.warning(
            "%s: fl_x has no w and h; it is taken to be for photos of %dx%d, which see %.1f "
            "degrees across; give w and h if that is wrong",
            *(file, lens.width, lens.height, view),
        )
    return photos, missing


def _points_file(root: Path, document: dict[str, Any], file: Path) -> Path | None:
    """The file of ``ply_file_path``, nerfstudio's field for points; a warning if it is missing."""
    name = document.get("ply_file_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise DataError(f"{file}: ply_file_path is not a string; correct it")
    path = inside(root, name, f"{file}: ply_file_path")
    if not path.is_file():
        _log.warning(
            "%s: ply_file_path: there is no file %s; points are sought in the photos", file, name
        )
        return None
    return path


def count_frames(file: Path, document: dict[str, Any]) -> int:
    """The number of frames; DataError if there are no frames."""
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise DataError(f"{file}: frames is missing or empty; list one entry for each photo")
    return len(frames)


def read_frame(file: Path, document: dict[str, Any], number: int) -> ListedPhoto:
    """One frame of a document whose frames were counted.

    Raises:
        DataError: names file, frame and field.
    """
    frame, source = document["frames"][number], f"{file}: frame {number}"
    if not isinstance(frame, dict):
        raise DataError(f"{source} is not an object; correct it")
    fields = _Fields(frame, document, source, str(file))
    rotation, translation = fields.pose()
    if "file_path" not in frame:
        fields.fail("file_path", "is missing; name the image")
    size = None
    level = fields.level(SIZE)
    if all(key in level for key in SIZE):
        width, height = (fields.number(key, 0, SIZE) for key in SIZE)
        if not (1 <= width <= 1e6 and 1 <= height <= 1e6):
            fields.fail("w, h", "are not image sizes; correct them")
        size = round(width), round(height)
    lens = partial(_read_lens, fields)
    lens(*(size or (1, 1)))  # a bad file is bad on every machine, even if the image is missing
    mask = None if frame.get("mask_path") is None else fields.text("mask_path", "")
    name = fields.text("file_path", "")
    return ListedPhoto(name, source, rotation, translation, size, lens, mask)


@dataclass(frozen=True)
class _Fields:
    """The fields of one frame, then those that all frames share, read with checks.

    source, shared_source: where they are, for messages.
    """

    frame: dict[str, Any]
    shared: dict[str, Any]
    source: str
    shared_source: str

    def level(self, group: Sequence[str]) -> dict[str, Any]:
        """The fields of the frame if it has any of ``group``, else the shared ones."""
        return self.frame if any(key in self.frame for key in group) else self.shared

    def fail(self, key: str, problem: str) -> NoReturn:
        is_shared = key not in self.frame and key in self.shared
        raise DataError(f"{self.shared_source if is_shared else self.source}: {key} {problem}")

    def number(self, key: str, default: float, group: Sequence[str]) -> float:
        value = self.level(group).get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(key, "is not a number; correct it")
        if not abs(value) < 1e15:
            self.fail(key, "is not a finite number of sensible size; correct it")
        return float(value)

    def listed_coefficients(self, names: Sequence[str]) -> dict[str, float]:
        """The coefficients ``names`` of the field LISTED."""
        order, given = COEFFICIENTS["OPENCV"].split(), self.level(DISTORTION)[LISTED]
        if not isinstance(given, list) or len(given) != len(order):
            self.fail(
                LISTED, f"is not a list of the {len(order)} numbers {' '.join(order)}; correct it"
            )
        single = replace(self, frame=dict(zip(order, given, strict=True)))
        every = {name: single.number(name, 0.0, order) for name in order}
        return {name: every[name] for name in names}

    def text(self, key: str, default: str) -> str:
        value = self.frame.get(key, self.shared.get(key, default))
        if not isinstance(value, str):
            self.fail(key, "is not a string; correct it")
        return value

    def pose(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """World-to-camera rotation and translation, OpenCV axes."""
        try:
            matrix = np.array(plain_numbers(self.frame.get("transform_matrix")), np.float64)
        except (TypeError, ValueError, OverflowError, RecursionError):
            self.fail("transform_matrix", "is not a 4x4 matrix of numbers; correct it")
        if matrix.shape not in ((4, 4), (3, 4)):
            self.fail("transform_matrix", "is missing or not 4x4; correct it")
        camera_to_world = matrix[:3, :3] * np.array([1.0, -1.0, -1.0])
        rotation = rigid(camera_to_world, f"{self.source}: transform_matrix").T
        if not np.all(np.abs(matrix[3:] - (0.0, 0.0, 0.0, 1.0)) <= 1e-6):
            self.fail("transform_matrix", "does not end in 0 0 0 1; is it transposed? correct it")
        centre = matrix[:3, 3]
        if not np.all(np.abs(centre) < 1e12):
            self.fail("transform_matrix", "has no finite position; correct it")
        return rotation, -rotation @ centre


def _read_lens(fields: _Fields, width: int, height: int) -> Lens:
    flagged = fields.frame.get("is_fisheye", fields.shared.get("is_fisheye", False)) is True
    model = fields.text("camera_model", "OPENCV_FISHEYE" if flagged else "OPENCV").upper()
    if model not in COEFFICIENTS:
        known = ", ".join(COEFFICIENTS)
        fields.fail("camera_model", f"{model[:40]!r} is unknown; undistort to one of {known}")
    if LISTED in fields.level(DISTORTION):
        model = model if "FISHEYE" in model else "OPENCV"
        coefficients = fields.listed_coefficients(COEFFICIENTS[model].split())
    else:
        names = COEFFICIENTS[model].split()
        coefficients = {name: fields.number(name, 0.0, DISTORTION) for name in names}
    focal = _focal_lengths(fields, width, height)
    centre = fields.number("cx", width / 2, CENTRE), fields.number("cy", height / 2, CENTRE)
    return Lens.of_model(model, (width, height), focal, centre, coefficients)


def _focal_lengths(fields: _Fields, width: int, height: int) -> tuple[float, float]:
    """fl_x and fl_y, or those of the fields of view; if only one is known, pixels are square."""
    known, level = {}, fields.level(FOCAL)
    sizeless = not any(key in fields.level(group) for group in (SIZE, CENTRE) for key in group)
    if sizeless and any(angle in level for angle in ANGLES):
        # angles hold for photos of every size, lengths do not
        level = {key: value for key, value in level.items() if key not in LENGTHS}
    for axis, size in (("x", width), ("y", height)):
        if f"fl_{axis}" in level:
            known[axis] = fields.number(f"fl_{axis}", 0.0, FOCAL)
        elif f"camera_angle_{axis}" in level:
            angle = fields.number(f"camera_angle_{axis}", 0.0, FOCAL)
            if not 0 < angle < np.pi:
                fields.fail(f"camera_angle_{axis}", "is not between 0 and pi; correct it")
            known[axis] = 0.5 * size / float(np.tan(angle / 2))
    if not known:
        fields.fail("fl_x", "and camera_angle_x are missing; give one of them")
    fx = known.get("x", known.get("y", 0.0))
    # A given fl_x without fl_y means square pixels, even if there is a rounded camera_angle_y.
    fy = known.get("y", fx) if "fl_y" in level or "fl_x" not in level else fx
    least, most = FOCAL_LENGTHS
    if not (least <= fx <= most and least <= fy <= most):
        found = f"are {fx:g} and {fy:g}, not {least:g} to {most:g} pixels"
        fields.fail("fl_x, fl_y", f"{found}; correct them")
    return fx, fy


def read_json(file: Path, kind: type = dict, lenient: bool = False) -> Any:
    """The JSON object in ``file``, or what else the ``kind`` is.

    NaN and Infinity are numbers if ``lenient``, else refused.

    Raises:
        DataError: missing, too large, not JSON, or of another kind.
    """
    if not file.is_file():
        raise DataError(f"{file}: missing; the data set needs it")
    if file.stat().st_size > MAX_BYTES:
        raise DataError(f"{file}: larger than {MAX_BYTES >> 20} MiB; split the data set")

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not a number")

    try:
        found = json.loads(file.read_bytes(), parse_constant=None if lenient else refuse)
    except RecursionError:
        raise DataError(f"{file}: nested too deeply; it is no file of cameras") from None
    except ValueError as error:
        problem = " ".join(str(error).split())[:120]
        raise DataError(f"{file}: invalid JSON ({problem}); correct it") from error
    if not isinstance(found, kind):
        raise DataError(f"{file}: is no JSON of the expected form; export again")
    return found


def _find_listed(
    given: list[str], photos: list[Photo], missing: list[str]
) -> tuple[set[str], list[str]]:
    """The names of the photos that a list means, and those on the list that no frame has.

    An entry may lack its suffix, differ as names on two machines do, or lack folders or have more
    of them than the frame, as long as it fits one photo alone.
    """
    known = [(p.name, name) for p in photos for name in (p.name, p.listed) if name]
    known += [("", name) for name in missing]
    exact: dict[str, set[str]] = {}
    alike: dict[str, set[str]] = {}
    bare: dict[str, set[str]] = {}
    for photo, name in known:
        for form in (name, str(PurePosixPath(name).with_suffix(""))):
            plain = plain_name(form)
            exact.setdefault(form, set()).add(photo)
            alike.setdefault(plain, set()).add(photo)
            bare.setdefault(PurePosixPath(plain).name, set()).add(photo)
    found: set[str] = set()
    strangers = set()
    for name in given:
        plain, portable = plain_name(name), PurePosixPath(name.replace("\\", "/")).as_posix()
        named = bare.get(PurePosixPath(plain).name, set())
        fitting = exact.get(portable) or alike.get(plain) or (named if len(named) == 1 else set())
        found |= fitting
        if not fitting:
            strangers.add(portable)
    return found - {""}, sorted(strangers)
