"""Visible anchors to neural Gaussians in float64: the MLPs, then what they draw."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.reference import mlp, neural
from clgs.reference.project import Array


def forward(
    anchors: tuple[Array, Array, Array, Array],
    visible: npt.NDArray[np.int32],
    weights: Array,
    camera: Array,
) -> neural.NeuralGaussians:
    """Gaussians in the order of ``visible``, which holds no -1.

    anchors: position (A, 3), offset (A, K, 3), feature (A, F), scaling (A, 6).
    """
    position, offset, feature, scaling = anchors
    output = mlp.forward(feature, position, visible, weights, camera).output
    return neural.forward(output, visible, position, offset, scaling)
