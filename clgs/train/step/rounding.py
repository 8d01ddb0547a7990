"""The steps to which the weights of the MLPs are rounded at the end of training.

Rounded weights go through the render, gradients go to the unrounded ones (straight-through
estimator), as for anchors. A scene is the less sensitive to a weight the later its head counts:
opacity decides what is there, the shapes of Gaussians forgive most.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.scene.mlps import MLP_SIZE, head_shapes, unpack_head

BINARY_PLACES = {"opacity": (9, 10), "color": (8, 9), "covariance": (7, 7)}
"""Of each head's hidden and output layer: weights and biases are multiples of 2^-places."""


def weight_scales() -> npt.NDArray[np.float32]:
    """Integers per unit of every weight, (13710,) float32, powers of two."""
    scales = np.empty(MLP_SIZE, np.float32)
    for head, (hidden, output) in BINARY_PLACES.items():
        views = unpack_head(scales, head)
        for name in head_shapes(head):
            views[name][...] = 2.0 ** (hidden if name.startswith("hidden") else output)
    return scales
