"""A file of ordinary Gaussians, and what a reader finds in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.scene.gaussians import HostGaussians

MAX_OPACITY = 1.0 - 1e-6
"""Opacities of 0 and 1 have no logit; readers come this close to them."""


@dataclass(frozen=True)
class Encoded:
    """The bytes of a file, and the Gaussians that it holds after rounding."""

    data: bytes
    gaussians: HostGaussians


def sigmoid(logit: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Opacities in (0, 1) of logits."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logit.astype(np.float64), -80.0, 80.0))))


def logit(opacity: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """The inverse of :func:`sigmoid`."""
    inside = np.clip(opacity, 1.0 - MAX_OPACITY, MAX_OPACITY)
    return np.log(inside / (1.0 - inside)).astype(np.float32)


def unit_rotation(rotation: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Quaternions (N, 4) of length 1; one without direction becomes that of no rotation."""
    wide = rotation.astype(np.float64)
    length = np.linalg.norm(wide, axis=1, keepdims=True)
    wide = np.where(length > 0, wide, [1.0, 0.0, 0.0, 0.0])
    return np.asarray(wide / np.where(length > 0, length, 1.0))
