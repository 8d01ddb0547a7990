"""What the stages of a render pass on, and what its backward pass returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, mlp, neural, project, tiles
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings, Scene


@dataclass(frozen=True)
class DeviceScene:
    """Parameters of a scene on the device, float32.

    position (A, 3), offset (A, K, 3), feature (A, F), scaling (A, 6), weights (13710,).
    """

    position: DeviceArray
    offset: DeviceArray
    feature: DeviceArray
    scaling: DeviceArray
    weights: DeviceArray


@dataclass(frozen=True)
class DeviceView:
    """A camera of ``size`` (width, height) pixels and what lies behind the scene.

    camera (26,) float32 from ``Camera.pack``; background (3,) float32.
    """

    camera: DeviceArray
    size: tuple[int, int]
    background: DeviceArray


@dataclass(frozen=True)
class Frame:
    """One rendered view with everything that its backward pass needs."""

    camera: DeviceArray
    size: tuple[int, int]
    activations: mlp.Activations
    gaussians: neural.NeuralGaussians
    projected: project.Projected
    tiles: tiles.TileLists
    background: DeviceArray
    blended: blend.Blended

    @property
    def image(self) -> DeviceArray:
        """The picture (3, H, W) float32."""
        return self.blended.image


@dataclass(frozen=True)
class SceneGradients:
    """Gradients of the loss by the trained parameters, dense over all anchors, float32.

    d_offset (A, K, 3), d_feature (A, F), d_scaling (A, 6), d_weights (13710,); and d_mean2d (N, 2)
    in pixels, which drives densification.
    """

    d_offset: DeviceArray
    d_feature: DeviceArray
    d_scaling: DeviceArray
    d_weights: DeviceArray
    d_mean2d: DeviceArray


def upload_scene(device: Device, scene: Scene) -> DeviceScene:
    """Copy a scene's parameters to the device."""
    anchors = scene.anchors
    parameters = (anchors.position, anchors.offset, anchors.feature, anchors.scaling)
    arrays = [device.upload(array) for array in (*parameters, scene.mlps.flat)]
    return DeviceScene(*arrays)


def upload_view(device: Device, camera: Camera, settings: RenderSettings) -> DeviceView:
    """Copy a camera and the settings of a render to the device."""
    return DeviceView(
        device.upload(camera.pack(settings.near)),
        (camera.width, camera.height),
        device.upload(np.array(settings.background, np.float32)),
    )
