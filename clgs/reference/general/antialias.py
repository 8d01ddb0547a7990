"""Opacities that keep the light of Gaussians which the screen's blur widens, in float64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.constants import BLUR
from clgs.reference.project import Array, covariance2d, unpack


def forward(
    mean: Array, scale: Array, rotation: Array, opacity: Array, camera: npt.NDArray[np.floating]
) -> Array:
    """Opacities (N,); shapes as in ``clgs.ops.general.antialias.forward``."""
    blurred = covariance2d(unpack(camera), mean, scale, rotation)
    sharp = np.linalg.det(blurred - BLUR * np.eye(2))
    return np.asarray(opacity * np.sqrt(np.maximum(sharp, 0) / np.linalg.det(blurred)))
