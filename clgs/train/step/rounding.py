"""Anchors and weights as they are rendered and stored after the switch steps: rounded.

Rounded parameters go through the render, and their gradients are taken as those of the unrounded
ones (straight-through estimator). The opacity head gets the finest steps, because it decides what
is there; the shapes of Gaussians forgive most.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.ops import quantize
from clgs.scene.anchors import DeviceAnchors, QuantizationScales
from clgs.scene.mlps import MLP_SIZE, head_shapes, unpack_head

BINARY_PLACES = {"opacity": (9, 10), "color": (8, 9), "covariance": (7, 7)}
"""Of each head's hidden and output layer: weights and biases are multiples of 2^-places."""


def rounded_anchors(
    device: Device, anchors: DeviceAnchors, scales: QuantizationScales
) -> DeviceAnchors:
    """Anchors rounded to multiples of 1/Q; positions lie on their grid already."""
    names = ("offset", "feature", "scaling")
    arrays = [(getattr(anchors, name), getattr(scales, name)) for name in names]
    return DeviceAnchors(anchors.position, *quantize.forward_all(device, arrays))


def weight_scales() -> npt.NDArray[np.float32]:
    """Integers per unit of every weight, (13710,) float32, powers of two."""
    scales = np.empty(MLP_SIZE, np.float32)
    for head, (hidden, output) in BINARY_PLACES.items():
        views = unpack_head(scales, head)
        for name in head_shapes(head):
            views[name][...] = 2.0 ** (hidden if name.startswith("hidden") else output)
    return scales
