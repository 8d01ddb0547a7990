"""COLMAP models (sparse/0, binary or text, with or without rigs) to posed photos and points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from clgs.data.colmap.binary_check import check_name
from clgs.data.colmap.reconstruction import PosedImage, Reconstruction, read_elsewhere
from clgs.data.find import find_mask
from clgs.data.images import stored_size
from clgs.data.lens import Lens
from clgs.data.posed_photo import Photo, PhotoSet, fit_lens, hold_out, inside, rigid
from clgs.errors import DataError

CAMERA_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
}
"""Parameters of the models that can be undistorted, in COLMAP's order."""

_FILES = ("cameras", "images", "points3D")


def find_model(root: Path) -> Path | None:
    """The folder below ``root`` that holds a COLMAP model: sparse/0, else sparse."""
    for folder in (root / "sparse" / "0", root / "sparse"):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    return None


def read_colmap(root: Path, model: Path) -> PhotoSet:
    """Photos of ``root``/images posed by ``model``, with masks; every 8th by name is held out.

    Raises:
        DataError: naming file, field and remedy.
    """
    suffix = ".bin" if (model / "cameras.bin").is_file() else ".txt"
    for name in _FILES:
        file = model / f"{name}{suffix}"
        if not file.is_file():
            raise DataError(f"{file}: missing; export the model again")
    return photo_set(root, model, read_elsewhere(model))


def photo_set(root: Path, model: Path, found: Reconstruction) -> PhotoSet:
    """Photos of ``root``/images that are there, and finite points, of what ``model`` holds.

    Raises:
        DataError: naming file, field and remedy.
    """
    folder = root / "images" if (root / "images").is_dir() else root
    photos, missing = _photos(found.images, root, folder, model)
    train, test = hold_out(photos)
    finite = np.all(np.abs(found.position) < 1e12, axis=1)
    points, colors = found.position[finite], found.color[finite]
    return PhotoSet("colmap", train, test, missing, points, colors)


def _photos(
    posed: list[PosedImage], root: Path, folder: Path, model: Path
) -> tuple[list[Photo], list[str]]:
    photos, names, missing = [], set(), []
    for image in posed:
        source = f"{model}: image {image.name[:80]!r}"
        check_name(image.name, str(model))
        if image.name in names:
            raise DataError(f"{source} has two poses; keep one of the two")
        names.add(image.name)
        path = inside(folder, image.name, source)
        if path.is_file():
            photos.append(replace(_photo(image, path, source), mask=find_mask(root, image.name)))
        else:
            missing.append(image.name)
    if not photos:
        first = f"; put them there, {missing[0][:80]} and so on" if missing else ""
        raise DataError(
            f"{folder}: none of the {len(posed)} posed images of {model} is there{first}"
        )
    return photos, missing


def _photo(image: PosedImage, path: Path, source: str) -> Photo:
    rotation = rigid(np.array(image.rotation), f"{source}: rotation")
    translation = np.array(image.translation)
    if not np.all(np.abs(translation) < 1e12):
        raise DataError(f"{source}: translation is not finite; export the model again")
    lens = _lens(image, source)
    lens = fit_lens(lens, stored_size(path, (lens.width, lens.height)), path)
    return Photo(image.name, path, lens, rotation, translation)


def _lens(camera: PosedImage, source: str) -> Lens:
    model = camera.model
    if model not in CAMERA_MODELS:
        raise DataError(
            f"{source}: camera model {model} cannot be undistorted here; run COLMAP's "
            "image_undistorter first"
        )
    values = dict(zip(CAMERA_MODELS[model].split(), camera.params, strict=True))
    fx, fy = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
    if not (np.all(np.isfinite(list(values.values()))) and fx > 0 and fy > 0):
        raise DataError(f"{source}: camera parameters are not finite and positive; export again")
    if not (1 <= camera.width <= 1e6 and 1 <= camera.height <= 1e6):
        raise DataError(
            f"{source}: camera size {camera.width}x{camera.height} is impossible; "
            "export the model again"
        )
    full = model == "FULL_OPENCV"
    return Lens(
        camera.width,
        camera.height,
        fx,
        fy,
        values["cx"],
        values["cy"],
        tuple(values.get(f"k{i}", 0.0) for i in ((1, 2, 3) if full else (1, 2, 3, 4))),
        tuple(values[f"k{i}"] for i in (4, 5, 6)) if full else (),
        (values.get("p1", 0.0), values.get("p2", 0.0)),
        "FISHEYE" in model,
    )
