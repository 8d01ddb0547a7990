"""Structure from motion by pycolmap, in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clgs.data.photos.cameras import camera_numbers
from clgs.data.photos.find import MASKS
from clgs.data.photos.masks import undistort_masks
from clgs.data.pycolmap_lazy import quiet_pycolmap
from clgs.data.sfm.child import run_child, serve
from clgs.errors import DataError

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

_TASK = "structure from motion"


@dataclass(frozen=True)
class Model:
    """registered photos; points; error: mean reprojection error in pixels."""

    registered: int
    points: int
    error: float


def reconstruct(
    target: Path, sizes: set[tuple[int, int]], seed: int, on_stage: Callable[[str], None]
) -> Model:
    """Poses and points of the photos in ``target``/work/images: fills images/ and sparse/0/.

    Args:
        target: folder of the new data set.
        sizes: of the photos, (width, height).
        seed: of all random choices.
        on_stage: called with "features", "matches", "poses" and "undistort".

    Raises:
        DataError: no reconstruction, no pycolmap, or it crashed.
    """
    arguments = [str(target), sorted(sizes), seed]
    return Model(**run_child(__name__, _TASK, arguments, on_stage))


def main() -> None:
    """The process that does the work."""
    serve(_work)


def _work(arguments: Any, on_stage: Callable[[str], None]) -> dict[str, Any]:
    target, sizes, seed = arguments
    return asdict(_reconstruct(Path(target), {(w, h) for w, h in sizes}, seed, on_stage))


def _reconstruct(
    target: Path, sizes: set[tuple[int, int]], seed: int, on_stage: Callable[[str], None]
) -> Model:
    work = target / "work"
    images, database = work / "images", work / "database.db"
    with quiet_pycolmap(_TASK) as pycolmap:
        pycolmap.set_random_seed(seed)
        on_stage("features")
        _extract(pycolmap, database, images, sizes)
        on_stage("matches")
        _match(pycolmap, database, len(list(images.iterdir())), seed)
        on_stage("poses")
        model = _map(pycolmap, database, images, work, seed)
        on_stage("undistort")
        _undistort(pycolmap, model, images, work, target)
        error = float(model.compute_mean_reprojection_error())
        return Model(model.num_reg_images(), model.num_points3D(), error)


def _extract(pycolmap: Any, database: Path, images: Path, sizes: set[tuple[int, int]]) -> None:
    small = max(max(size) for size in sizes) <= SMALL_SIZE
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    # Explicit, because pycolmap warns about memory if it may choose.
    options.num_threads = os.cpu_count() or 1
    options.max_image_size = MAX_SIFT_SIZE
    options.sift.max_num_features = MAX_FEATURES_SMALL if small else MAX_FEATURES
    options.sift.first_octave = -1 if small else 0
    options.sift.peak_threshold = PEAK_THRESHOLD
    shared = len(set(camera_numbers(sorted(images.iterdir())))) == 1
    mode = pycolmap.CameraMode.SINGLE if shared else pycolmap.CameraMode.AUTO
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    if (images.parent / MASKS).is_dir():
        reader.mask_path = images.parent / MASKS
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
    undistort_masks(pycolmap, model, work / MASKS, target / "images", target / MASKS)
    (target / "sparse").mkdir()
    (work / "undistorted" / "sparse").rename(target / "sparse" / "0")
