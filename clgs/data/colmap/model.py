"""COLMAP models (sparse/0, binary or text, with or without rigs) to posed photos and points."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from clgs.data.colmap.binary import read_binary
from clgs.data.colmap.records import ColmapCamera, ColmapModel
from clgs.data.colmap.text import read_text
from clgs.data.lens import Lens
from clgs.data.locate import ListedPhoto, locate_all
from clgs.data.posed_photo import PhotoSet, hold_out, rigid
from clgs.errors import DataError

NOT_UNDISTORTED = ("FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE")
"""Camera models whose distortion is not removed here."""


def find_model(root: Path) -> Path | None:
    """The folder below ``root`` that holds a COLMAP model: sparse/0, else sparse."""
    for folder in (root / "sparse" / "0", root / "sparse"):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    return None


def read_model(folder: Path) -> ColmapModel:
    """The model in a folder, binary if there is a cameras.bin, else text.

    Raises:
        DataError: names file, place and remedy.
    """
    binary = (folder / "cameras.bin").is_file()
    for name in ("cameras", "images", "points3D"):
        file = folder / f"{name}{'.bin' if binary else '.txt'}"
        if not file.is_file():
            raise DataError(f"{file}: missing; export the model again")
    return read_binary(folder) if binary else read_text(folder)


def read_colmap(root: Path, folder: Path) -> PhotoSet:
    """Photos of ``root``/images posed by the model in ``folder``, with masks.

    Every 8th photo by name is held out; points that are not finite are left out.

    Raises:
        DataError: names file, field and remedy.
    """
    model = read_model(folder)
    listed = []
    for image in model.images:
        source = f"{folder}: image {image.name[:80]!r}"
        camera = image.camera
        listed.append(
            ListedPhoto(
                image.name,
                source,
                rigid(image.rotation(), f"{source}: rotation"),
                np.array(image.translation),
                (camera.width, camera.height),
                partial(_lens, camera, source),
                mask_by_name=True,
            )
        )
    images = root / "images" if (root / "images").is_dir() else root
    photos, missing = locate_all(listed, root, images, str(folder))
    usable = np.all(np.abs(model.position) < 1e12, axis=1)
    return PhotoSet(
        "colmap", *hold_out(photos), missing, model.position[usable], model.color[usable]
    )


def _lens(camera: ColmapCamera, source: str, width: int, height: int) -> Lens:
    if camera.model in NOT_UNDISTORTED:
        raise DataError(
            f"{source}: camera model {camera.model} cannot be undistorted here; run COLMAP's "
            "image_undistorter first"
        )
    values = camera.values()
    fx, fy = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
    return Lens.of_model(
        camera.model, (width, height), (fx, fy), (values["cx"], values["cy"]), values
    )
