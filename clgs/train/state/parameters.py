"""The trained parameters and their Adam moments, resident on the device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, quantize
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import AnchorSet, QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import Mlps

Moments = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]

ANCHOR_GROUPS = ("offset", "feature", "scaling")
"""Anchor tensors that Adam updates; positions have learning rate 0."""


@dataclass
class Parameters:
    """Device copies of anchors and MLP weights with first and second moments by group.

    ``moments`` holds one pair for each of ANCHOR_GROUPS and one for "weights".
    """

    scene: DeviceScene
    moments: dict[str, adam.Moments]

    @property
    def count(self) -> int:
        """Number of anchors."""
        return len(self.scene.position)


def upload_anchors(
    device: Device,
    anchors: AnchorSet,
    moments: dict[str, Moments],
    weights: DeviceArray,
    weight_moments: adam.Moments,
) -> Parameters:
    """Parameters from host anchors and moments; the MLP arrays stay where they are."""
    scene = DeviceScene(
        device.upload(anchors.position),
        device.upload(anchors.offset),
        device.upload(anchors.feature),
        device.upload(anchors.scaling),
        weights,
    )
    uploaded = {
        name: adam.Moments(device.upload(moments[name][0]), device.upload(moments[name][1]))
        for name in ANCHOR_GROUPS
    }
    return Parameters(scene, {**uploaded, "weights": weight_moments})


def new_parameters(device: Device, anchors: AnchorSet, mlps: Mlps) -> Parameters:
    """Parameters with zero moments."""
    zeros = {
        name: (np.zeros_like(getattr(anchors, name)), np.zeros_like(getattr(anchors, name)))
        for name in ANCHOR_GROUPS
    }
    weights = device.upload(mlps.flat)
    return upload_anchors(device, anchors, zeros, weights, adam.zero_moments(device, weights))


def download_anchors(
    device: Device, parameters: Parameters
) -> tuple[AnchorSet, dict[str, Moments]]:
    """Host copies of the anchors and of their moments."""
    scene = parameters.scene
    anchors = AnchorSet(
        device.download(scene.position),
        device.download(scene.offset),
        device.download(scene.feature),
        device.download(scene.scaling),
    )
    moments = {
        name: (
            device.download(parameters.moments[name].first),
            device.download(parameters.moments[name].second),
        )
        for name in ANCHOR_GROUPS
    }
    return anchors, moments


def quantized_view(device: Device, scene: DeviceScene, scales: QuantizationScales) -> DeviceScene:
    """The scene with offset, feature and scaling rounded to multiples of 1/Q.

    Gradients with respect to it are taken as gradients of the unrounded parameters
    (straight-through estimator). Positions lie on the grid already.
    """
    return DeviceScene(
        scene.position,
        quantize.forward(device, scene.offset, scales.offset),
        quantize.forward(device, scene.feature, scales.feature),
        quantize.forward(device, scene.scaling, scales.scaling),
        scene.weights,
    )


def quantized_anchors(anchors: AnchorSet, scales: QuantizationScales) -> QuantizedAnchors:
    """The integers of trained anchors, rounded in float32 as the kernel does; same row order."""
    return QuantizedAnchors(
        *(
            np.rint(getattr(anchors, name) * np.float32(getattr(scales, name))).astype(np.int32)
            for name in ("position", "offset", "feature", "scaling")
        )
    )
