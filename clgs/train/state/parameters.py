"""The trained parameters and their Adam moments, resident on the device."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.ops import adam
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import FIELDS, AnchorSet, take
from clgs.scene.mlps import Mlps

Moments = adam.Moments[npt.NDArray[np.float32]]

ANCHOR_GROUPS = tuple(name for name in FIELDS if name != "position")
"""Anchor tensors that Adam updates; positions have learning rate 0."""


@dataclass(frozen=True)
class Parameters:
    """Device copies of anchors and MLP weights with their moments.

    ``moments`` holds those of ANCHOR_GROUPS and of "weights", shaped as these are. ``hidden``
    anchors have a position of NaN and count no more; the densifier leaves out their rows later.
    """

    scene: DeviceScene
    moments: dict[str, adam.DeviceMoments]
    hidden: int = 0

    @property
    def rows(self) -> int:
        """Number of rows, those of hidden anchors among them."""
        return len(self.scene.anchors)

    @property
    def count(self) -> int:
        """Number of anchors."""
        return self.rows - self.hidden

    def download_anchors(self, device: Device) -> AnchorSet:
        """Host copies of the anchors that are not hidden."""
        anchors = self.scene.anchors.map(device.download)
        return take(anchors, ~np.isnan(anchors.position[:, 0])) if self.hidden else anchors

    def download_moments(self, device: Device) -> dict[str, Moments]:
        """Host copies of the moments of ANCHOR_GROUPS."""
        return {name: self.moments[name].map(device.download) for name in ANCHOR_GROUPS}

    def with_anchors(
        self, device: Device, anchors: AnchorSet, moments: dict[str, Moments]
    ) -> Parameters:
        """Other anchors, with the moments of ANCHOR_GROUPS; the MLP arrays stay where they are."""
        uploaded = {name: moments[name].map(device.upload) for name in ANCHOR_GROUPS}
        scene = replace(self.scene, anchors=anchors.map(device.upload))
        return Parameters(scene, {**self.moments, **uploaded})


def new_parameters(device: Device, anchors: AnchorSet, mlps: Mlps) -> Parameters:
    """Parameters with zero moments."""
    scene = DeviceScene(anchors.map(device.upload), device.upload(mlps.flat))
    moments = {
        name: adam.zero_moments(device, array)
        for name, array in scene.items()
        if name != "position"
    }
    return Parameters(scene, moments)
