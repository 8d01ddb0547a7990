"""A folder of raw photos to a COLMAP data set: structure from motion by pycolmap."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from clgs.data.images import image_size, is_plain, list_images, read_exif, read_image
from clgs.data.pycolmap_lazy import SEEDS
from clgs.data.sfm.mapper import JPEG_QUALITY, reconstruct
from clgs.errors import DataError, ExistsError, OutputError
from clgs.files import atomic_folder, check_folder, is_full

STAGES = ("read", "features", "matches", "poses", "undistort")
"""What ``prepare`` reports as it begins it."""


@dataclass(frozen=True)
class PrepareSummary:
    """registered of total photos; points; error: mean reprojection error in pixels."""

    registered: int
    total: int
    points: int
    error: float


def prepare(
    photos: Path | str,
    output: Path | str,
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
    overwrite: bool = False,
) -> PrepareSummary:
    """Poses and points of the JPEG and PNG files in ``photos`` (or its images/), in ``output``.

    ``output`` gets images/ (undistorted) and sparse/0/ (binary, pinhole cameras); it appears
    complete or not at all. ``on_stage`` is called with each of STAGES. With ``overwrite`` it may
    replace what an earlier call made.

    Raises:
        DataError: too few or damaged photos, no reconstruction, no pycolmap.
        OutputError: ``output`` is not empty, or cannot be made.
        OSError: the disk is full, or another fault of ``output``.
    """
    source, output = _find_photos(Path(photos)), Path(output)
    try:
        check_folder(output.parent)
        output.parent.mkdir(parents=True, exist_ok=True)
        if overwrite:
            _check_replaceable(output, source)
        with atomic_folder(output, overwrite) as target:
            return _prepare(source, target, seed, on_stage)
    except OutputError:
        raise
    except OSError as error:
        if is_full(error):  # a copy names the photo, which has no fault
            raise OSError(error.errno, error.strerror, str(output)) from error
        problem = error.strerror or str(error)
        raise DataError(f"{error.filename or output}: {problem}") from error


def _check_replaceable(output: Path, source: list[Path]) -> None:
    """Raise OutputError unless ``output`` is free, or an earlier result without these photos."""
    if not output.is_dir() or not any(output.iterdir()):
        return
    if not (output / "sparse" / "0" / "cameras.bin").is_file():
        raise ExistsError(f"{output}: was not made by clgs prepare; remove it or choose another")
    if any(output.resolve() in path.resolve().parents for path in source):
        raise ExistsError(f"{output}: holds the photos that are read; choose another")


def _find_photos(folder: Path) -> list[Path]:
    if folder.is_file():
        raise DataError(f"{folder}: is a file; name the folder of the photos ({folder.parent})")
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; check the path")
    found = list_images(folder)
    if not found and (folder / "images").is_dir():
        found = list_images(folder / "images")
    if len(found) < 3:
        raise DataError(f"{folder}: {len(found)} JPEG or PNG photos; at least 3 are needed")
    return found


def _prepare(
    source: list[Path], target: Path, seed: int, on_stage: Callable[[str], None]
) -> PrepareSummary:
    on_stage("read")
    work = target / "work"
    images = work / "images"
    images.mkdir(parents=True)
    sizes = {image_size(path) for path in source}
    for path in source:
        _copy_upright(path, images / path.name)
    model = reconstruct(target, sizes, seed % SEEDS, on_stage)
    shutil.rmtree(work)
    return PrepareSummary(model.registered, len(source), model.points, model.error)


def _copy_upright(path: Path, copy: Path) -> None:
    """The photo as pycolmap reads it best: upright, 8-bit RGB or grey, EXIF focal length kept."""
    if is_plain(path):
        shutil.copyfile(path, copy)
        return
    pixels = read_image(path)
    with Image.open(path, formats=("JPEG", "PNG")) as original:
        exif = read_exif(original)
    exif[0x0112] = 1
    picture = Image.fromarray(pixels.color)
    if copy.suffix.lower() == ".png":
        picture.save(copy, "PNG", exif=exif, compress_level=1)
    else:
        picture.save(copy, "JPEG", exif=exif, quality=JPEG_QUALITY, subsampling=0)
