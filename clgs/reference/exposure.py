"""Affine maps of the colors of pictures, (M | b) of 3 x 4 numbers; float64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def forward(image: Array, exposure: Array) -> Array:
    """M x + b of every pixel of ``image`` (3, H, W); ``exposure`` (3, 4)."""
    moved = np.tensordot(exposure[:, :3], image, axes=1)
    return np.asarray(moved + exposure[:, 3, None, None])


def penalty(exposure: Array, weight: float) -> float:
    """What a map that is not the identity costs."""
    return float(weight * np.sum((exposure - np.eye(3, 4)) ** 2))


def backward(image: Array, d_picture: Array, exposure: Array, weight: float) -> tuple[Array, Array]:
    """d_image (3, H, W), and d_exposure (3, 4) with that of the penalty."""
    d_image = np.tensordot(exposure[:, :3].T, d_picture, axes=1)
    d_matrix = np.tensordot(d_picture, image, axes=([1, 2], [1, 2]))
    d_exposure = np.concatenate([d_matrix, d_picture.sum(axis=(1, 2))[:, None]], axis=1)
    return np.asarray(d_image), d_exposure + 2 * weight * (exposure - np.eye(3, 4))


def centre(maps: Array) -> Array:
    """``maps`` (P, 3, 4), all moved alike so that their mean is the identity."""
    return np.asarray(maps - (maps.mean(axis=0) - np.eye(3, 4)))
