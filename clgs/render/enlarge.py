"""Enlarge pictures that were rendered small."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.float32]


def enlarge(image: Picture, width: int, height: int) -> Picture:
    """The planar picture (3, h, w) float32 as (3, height, width): bilinear, edges continued.

    Pixel centres lie at +0.5 in both, so that nothing is shifted.
    """
    if image.shape[1:] == (height, width):
        return image
    low, high, share = _neighbours(image.shape[1], height)
    rows = image[:, low] + (image[:, high] - image[:, low]) * share[:, None]
    low, high, share = _neighbours(image.shape[2], width)
    return np.asarray(rows[..., low] + (rows[..., high] - rows[..., low]) * share, np.float32)


def _neighbours(
    inputs: int, outputs: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Picture]:
    """For each output: the inputs on both sides of it, and the share of the second."""
    place = np.clip((np.arange(outputs) + 0.5) * (inputs / outputs) - 0.5, 0, inputs - 1)
    low = np.floor(place).astype(np.int64)
    return low, np.minimum(low + 1, inputs - 1), (place - low).astype(np.float32)
