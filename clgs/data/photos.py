"""A folder of raw photos to a COLMAP data set: structure from motion by pycolmap."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from clgs.data.images import image_size, is_plain, list_images, read_exif, read_image
from clgs.data.pycolmap_lazy import quiet_pycolmap
from clgs.errors import DataError
from clgs.files import atomic_folder

STAGES = ("read", "features", "matches", "poses", "undistort")
"""What ``prepare`` reports as it begins it."""

MAX_SIFT_SIZE = 1600
"""Features are searched in images of at most this longer side, pixels."""

SMALL_SIZE = 1024
"""Images up to this size are searched from twice their resolution on, for enough features."""

MAX_EXHAUSTIVE = 150
"""Up to so many photos every pair is matched, above it each with those that follow it by name."""

SEQUENTIAL_OVERLAP = 20
MAX_FEATURES = 4096
MAX_FEATURES_SMALL = 800
"""Of a small photo: pycolmap adds those of equal size, and matching time grows with the square."""

PEAK_THRESHOLD = 0.004
"""Contrast a feature needs; COLMAP's 0.0067 finds too few in small photos."""

JPEG_QUALITY = 95


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
) -> PrepareSummary:
    """Poses and points of the JPEG and PNG files in ``photos`` (or its images/), in ``output``.

    ``output`` gets images/ (undistorted) and sparse/0/ (binary, pinhole cameras); it appears
    complete or not at all. ``on_stage`` is called with each of STAGES.

    Raises:
        DataError: too few or damaged photos, no reconstruction, ``output`` not empty, no pycolmap.
    """
    source, output = _find_photos(Path(photos)), Path(output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with atomic_folder(output) as target:
            return _prepare(source, target, seed, on_stage)
    except OSError as error:
        problem = error.strerror or str(error)
        raise DataError(f"{error.filename or output}: {problem}") from error


def _find_photos(folder: Path) -> list[Path]:
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
    with quiet_pycolmap("structure from motion") as pycolmap:
        pycolmap.set_random_seed(seed)
        database = work / "database.db"
        on_stage("features")
        _extract(pycolmap, database, images, sizes)
        on_stage("matches")
        _match(pycolmap, database, len(source), seed)
        on_stage("poses")
        model = _map(pycolmap, database, images, work, seed)
        on_stage("undistort")
        _undistort(pycolmap, model, images, work, target)
        summary = PrepareSummary(
            model.num_reg_images(),
            len(source),
            model.num_points3D(),
            float(model.compute_mean_reprojection_error()),
        )
    shutil.rmtree(work)
    return summary


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


def _extract(pycolmap: Any, database: Path, images: Path, sizes: set[tuple[int, int]]) -> None:
    small = max(max(size) for size in sizes) <= SMALL_SIZE
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    # Explicit, because pycolmap warns about memory where it is left to choose.
    options.num_threads = os.cpu_count() or 1
    options.max_image_size = MAX_SIFT_SIZE
    options.sift.max_num_features = MAX_FEATURES_SMALL if small else MAX_FEATURES
    options.sift.first_octave = -1 if small else 0
    options.sift.peak_threshold = PEAK_THRESHOLD
    shared = len(sizes) == 1
    mode = pycolmap.CameraMode.SINGLE if shared else pycolmap.CameraMode.AUTO
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    pycolmap.extract_features(
        database,
        images,
        camera_mode=mode,
        reader_options=reader,
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def _match(pycolmap: Any, database: Path, count: int, seed: int) -> None:
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    keywords = {
        "matching_options": options,
        "verification_options": verification,
        "device": pycolmap.Device.cpu,
    }
    if count <= MAX_EXHAUSTIVE:
        pycolmap.match_exhaustive(database, **keywords)
        return
    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap = SEQUENTIAL_OVERLAP
    pycolmap.match_sequential(database, pairing_options=pairing, **keywords)


def _map(pycolmap: Any, database: Path, images: Path, work: Path, seed: int) -> Any:
    """The largest reconstruction."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = seed
    options.mapper.random_seed = seed
    options.triangulation.random_seed = seed
    options.min_model_size = 3
    options.ba_global_function_tolerance = 1e-6
    (work / "models").mkdir()
    models = pycolmap.incremental_mapping(database, images, work / "models", options=options)
    if not models:
        raise DataError(
            "no two photos could be related; take more, overlapping photos of a textured, "
            "motionless scene"
        )
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()))


def _undistort(pycolmap: Any, model: Any, images: Path, work: Path, target: Path) -> None:
    """Undistorted images and the model with pinhole cameras, in place in ``target``."""
    (work / "model").mkdir()
    model.write(work / "model")
    pycolmap.undistort_images(
        work / "undistorted", work / "model", images, jpeg_quality=JPEG_QUALITY
    )
    (work / "undistorted" / "images").rename(target / "images")
    (target / "sparse").mkdir()
    (work / "undistorted" / "sparse").rename(target / "sparse" / "0")
