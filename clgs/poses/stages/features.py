"""SIFT features of photos, by OpenCV, with COLMAP's conventions.

OpenCV needs a third of the time of pycolmap's own search.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import read_image
from clgs.errors import DataError
from clgs.poses.workspace import THREADS, Workspace

LAYERS = 3
"""Scales of an octave."""

CONTRAST = 0.004 * LAYERS
"""The least contrast of a feature, as OpenCV counts it. COLMAP's 0.0067 per scale, not 0.004, finds
too few in small photos."""

LENGTH = 512
"""The length of a descriptor; COLMAP's."""

Found = tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]


def opencv(task: str) -> Any:
    """Import OpenCV, which finds features in the calling thread alone then.

    Raises:
        DataError: it is not installed, or cannot be loaded.
    """
    try:
        import cv2
    except ImportError as error:
        raise DataError(
            f"{task}: OpenCV cannot be loaded ({error}); pip install opencv-python-headless"
        ) from error
    cv2.setNumThreads(1)
    return cv2


def find_sift(
    cv2: Any, grey: npt.NDArray[np.uint8], mask: npt.NDArray[np.uint8] | None, limit: int
) -> Found:
    """Find the ``limit`` largest features of a picture, searched at twice its resolution, too.

    Args:
        cv2: the module.
        grey: (H, W).
        mask: (H, W), 0 where nothing is wanted; or None.
        limit: see above.

    Returns:
        Keypoints (N, 6): x and y in pixels, 0.5 at the centre of the first, and the affine shape
        by rows; descriptors (N, 128), square roots of each share of the gradients (Arandjelovic and
        Zisserman, Three things everyone should know to improve object retrieval, 2012).
    """
    search = cv2.SIFT_create(
        nfeatures=0, nOctaveLayers=LAYERS, contrastThreshold=CONTRAST, enable_precise_upscale=True
    )
    found, raw = search.detectAndCompute(grey, mask)
    if not found:
        return np.empty((0, 6), np.float32), np.empty((0, 128), np.uint8)
    rows = np.array([(*one.pt, one.size / 2, np.radians(one.angle)) for one in found])
    largest = np.sort(np.argsort(-rows[:, 2], kind="stable")[:limit])
    x, y, scale, angle = rows[largest].T
    along, across = scale * np.cos(angle), scale * np.sin(angle)
    keypoints = np.stack([x + 0.5, y + 0.5, along, -across, across, along], axis=1)
    gradients = np.asarray(raw, np.float64)[largest]
    share = gradients / np.maximum(gradients.sum(axis=1, keepdims=True), 1)
    descriptors = np.minimum(np.rint(LENGTH * np.sqrt(share)), 255)
    return keypoints.astype(np.float32), descriptors.astype(np.uint8)


MAX_FEATURES = 8192
"""The most features of a photo, the largest ones; COLMAP's default."""

QUICK_FEATURES = 4096

FINEST_SIZE = 3200
"""Photos are searched at twice their resolution, but at this longer side at most, pixels; COLMAP's
default of the largest.

OpenCV doubles every picture, so that it is given half of that.
"""

BATCH = 4 * THREADS
"""Photos between two reports of progress."""


def extract(workspace: Workspace, size: int, quick: bool) -> None:
    """Write cameras, images and features of all photos into a new database.

    All images are numbered before the search begins, so that results do not depend on threads.

    ``size``: longer side of the largest photo, pixels; ``quick``: find fewer features.
    """
    pycolmap = workspace.pycolmap
    workspace.open().close()  # pycolmap imports into a database that exists
    for camera in sorted(set(workspace.cameras)):
        # The photos of one camera share its focal length and distortion.
        importing = pycolmap.ImageReaderOptions()
        importing.camera_model = "SIMPLE_RADIAL"
        cameras = zip(workspace.names, workspace.cameras, strict=True)
        workspace.call(
            pycolmap.import_images,
            workspace.database,
            workspace.images,
            camera_mode=pycolmap.CameraMode.SINGLE,
            image_names=[name for name, own in cameras if own == camera],
            options=importing,
        )
    cv2, limit = opencv("features"), QUICK_FEATURES if quick else MAX_FEATURES
    kept, todo = workspace.finished, list[str]()
    for name in workspace.names:
        if earlier := kept and kept.features(name):  # another process found them
            _write(workspace, name, earlier)
        else:
            todo.append(name)
    total = len(workspace.names)

    def search(name: str) -> Found:
        mask = None if workspace.masks is None else workspace.masks / f"{name}.png"
        return find_features(cv2, workspace.images / name, mask, size, limit)

    with ThreadPoolExecutor(THREADS) as pool:
        for start in range(0, len(todo), BATCH):
            workspace.on_progress("features", total - len(todo) + start, total)
            some = todo[start : start + BATCH]
            for name, found in zip(some, pool.map(search, some), strict=True):
                _write(workspace, name, found)
                if kept is not None:
                    kept.keep_features(name, *found)
    workspace.on_progress("features", total, total)


def _write(workspace: Workspace, name: str, found: Found) -> None:
    """Write the features of a photo into the database."""
    keypoints, descriptors = found
    kind = workspace.pycolmap.FeatureExtractorType.SIFT
    with workspace.open() as database:
        number = database.read_image_with_name(name).image_id
        database.write_keypoints(number, keypoints)
        described = workspace.pycolmap.FeatureDescriptors(kind, descriptors)
        database.write_descriptors(number, described)


def find_features(cv2: Any, photo: Path, mask: Path | None, size: int, limit: int) -> Found:
    """Find the ``limit`` largest features of one of several photos, as :func:`find_sift` does.

    ``size``: longer side of the largest of these, pixels.
    """
    shrink = min(1.0, FINEST_SIZE / 2 / size)
    grey = Image.fromarray(read_image(photo).color).convert("L")
    width, height = grey.size
    small = max(1, round(width * shrink)), max(1, round(height * shrink))
    used = None
    if mask is not None and mask.is_file():
        shown = Image.open(mask).convert("L").resize(small, Image.Resampling.NEAREST)
        used = np.asarray(shown)
    searched = np.asarray(grey.resize(small, Image.Resampling.LANCZOS))
    keypoints, descriptors = find_sift(cv2, searched, used, limit)
    keypoints *= np.tile([width / small[0], height / small[1]], 3).astype(np.float32)
    return keypoints, descriptors
