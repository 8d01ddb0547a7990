"""Anchors and weights as they are rendered and stored after the switch steps: rounded.

Rounded parameters are rendered, and their gradients are used as those of the parameters before
rounding (straight-through estimator). The opacity head has the finest steps, because it decides
what is visible; the shapes of Gaussians forgive most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import quantize
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import DeviceAnchors, QuantizationScales
from clgs.scene.mlps import MLP_SIZE, head_shapes, unpack_head
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import ANCHOR_GROUPS, RunState

BINARY_PLACES = {"opacity": (9, 10), "color": (8, 9), "covariance": (7, 7)}
"""Places of each head's hidden and output layer: its numbers are multiples of 2^-places."""


class Rounding:
    """Rounds the parameters of a run as its settings say."""

    def __init__(self, device: Device, config: TrainConfig) -> None:
        """Keep the scales of the weights on ``device`` if these are rounded at all."""
        self._device, self._config = device, config
        quantized = config.mlp == "quantized"
        self._weight_scales = device.upload(weight_scales()) if quantized else None

    def scene_at(self, state: RunState, step: int) -> DeviceScene:
        """The scene as step number ``step`` renders it: rounded after the switch steps."""
        scene = state.parameters.scene
        with self._device.stage("quantize"):
            if step > self._config.switch_step:
                anchors = rounded_anchors(self._device, scene.anchors, state.rate.scales)
                scene = replace(scene, anchors=anchors)
            if step > self._config.mlp_switch_step:
                scene = replace(scene, weights=self.final_weights(state))
        return scene

    def final_weights(self, state: RunState) -> DeviceArray:
        """The weights of the MLPs as they are stored: rounded unless float32 is asked for."""
        weights = state.parameters.scene.weights
        if self._weight_scales is None:
            return weights
        return quantize.elements(self._device, weights, self._weight_scales)


def rounded_anchors(
    device: Device, anchors: DeviceAnchors, scales: QuantizationScales
) -> DeviceAnchors:
    """Anchors rounded to multiples of 1/Q; positions lie on their grid already."""
    arrays = [(getattr(anchors, name), getattr(scales, name)) for name in ANCHOR_GROUPS]
    return DeviceAnchors(anchors.position, *quantize.forward(device, arrays))


def weight_scales() -> npt.NDArray[np.float32]:
    """Integers per unit of every weight, (13710,) float32, powers of two."""
    scales = np.empty(MLP_SIZE, np.float32)
    for head, (hidden, output) in BINARY_PLACES.items():
        views = unpack_head(scales, head)
        for name in head_shapes(head):
            views[name][...] = 2.0 ** (hidden if name.startswith("hidden") else output)
    return scales
