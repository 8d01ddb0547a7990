"""SIFT features of photos."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from clgs.data.images import read_image
from clgs.poses.stages import sift
from clgs.poses.workspace import THREADS, Workspace

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
    cv2, limit = sift.opencv("features"), QUICK_FEATURES if quick else MAX_FEATURES
    shrink = min(1.0, FINEST_SIZE / 2 / size)
    kept, todo = workspace.finished, list[str]()
    for name in workspace.names:
        if earlier := kept and kept.features(name):  # another process found them
            _write(workspace, name, earlier)
        else:
            todo.append(name)
    total = len(workspace.names)

    def search(name: str) -> sift.Found:
        mask = None if workspace.masks is None else workspace.masks / f"{name}.png"
        return _find(cv2, workspace.images / name, mask, shrink, limit)

    with ThreadPoolExecutor(THREADS) as pool:
        for start in range(0, len(todo), BATCH):
            workspace.on_progress("features", total - len(todo) + start, total)
            some = todo[start : start + BATCH]
            for name, found in zip(some, pool.map(search, some), strict=True):
                _write(workspace, name, found)
                if kept is not None:
                    kept.keep_features(name, *found)
    workspace.on_progress("features", total, total)


def _write(workspace: Workspace, name: str, found: sift.Found) -> None:
    """Write the features of a photo into the database."""
    keypoints, descriptors = found
    kind = workspace.pycolmap.FeatureExtractorType.SIFT
    with workspace.open() as database:
        number = database.read_image_with_name(name).image_id
        database.write_keypoints(number, keypoints)
        described = workspace.pycolmap.FeatureDescriptors(kind, descriptors)
        database.write_descriptors(number, described)


def _find(cv2: Any, photo: Path, mask: Path | None, shrink: float, limit: int) -> sift.Found:
    """Find the ``limit`` largest features of a photo that is searched at ``shrink`` of its size."""
    grey = Image.fromarray(read_image(photo).color).convert("L")
    width, height = grey.size
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    used = None
    if mask is not None:
        shown = Image.open(mask).convert("L").resize(size, Image.Resampling.NEAREST)
        used = np.asarray(shown)
    searched = np.asarray(grey.resize(size, Image.Resampling.LANCZOS))
    keypoints, descriptors = sift.find(cv2, searched, used, limit)
    keypoints *= np.tile([width / size[0], height / size[1]], 3).astype(np.float32)
    return keypoints, descriptors
