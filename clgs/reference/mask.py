"""Masks of photos: pixels that are not used become zero; float64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def forward(image: Array, used: npt.NDArray[np.uint8]) -> Array:
    """used * image, (3, H, W); ``used`` (H, W) of 0 and 1."""
    return np.asarray(used * image)


def backward(d_masked: Array, used: npt.NDArray[np.uint8]) -> Array:
    """d_image (3, H, W) of :func:`forward`."""
    return np.asarray(used * d_masked)
