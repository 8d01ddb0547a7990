"""SIFT features of a grey picture, by OpenCV, with COLMAP's conventions.

OpenCV needs a third of the time of pycolmap's own search.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import DataError

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


def find(
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
