"""Visible anchors to Gaussians on the screen in float64: the MLPs, what they draw, and where."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.reference import mlp, neural, project
from clgs.reference.project import Array


def forward(
    anchors: tuple[Array, Array, Array, Array],
    visible: npt.NDArray[np.int32],
    weights: Array,
    camera: npt.NDArray[np.floating],
) -> tuple[project.Projected, Array, Array]:
    """Projections, colors and opacities in the order of ``visible``, which holds no -1.

    anchors: position (A, 3), offset (A, K, 3), feature (A, F), scaling (A, 6).
    """
    position, offset, feature, scaling = anchors
    output = mlp.forward(feature, position, visible, weights, camera).output
    drawn = neural.forward(output, visible, position, offset, scaling)
    shape = drawn.mean, drawn.scale, drawn.rotation
    projected = project.forward(*shape, drawn.opacity, camera)
    return projected, drawn.color, drawn.opacity
