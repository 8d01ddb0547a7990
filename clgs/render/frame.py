"""What the stages of a render pass on, and what its backward pass returns."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, mlp, neural, project, tiles
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
class Capacity:
    """Room for visible anchors, Gaussians and tile entries; more than that is left out."""

    visible: int
    gaussians: int
    entries: int

    def grown(self, needed: Capacity) -> Capacity:
        """With room for ``needed`` and a quarter more where there is too little."""
        pairs = zip(astuple(needed), astuple(self), strict=True)
        return Capacity(
            *(room if count <= room else count + count // 4 + 1024 for count, room in pairs)
        )


@dataclass(frozen=True)
class Groups:
    """``rows``: first and end of the rows of tiles of each group; entries of the largest group."""

    rows: tuple[tuple[int, int], ...]
    entries: int


@dataclass(frozen=True)
class Frame:
    """One rendered view with everything that its backward pass needs.

    groups: what was drawn at a time where a memory budget asked for it; tiles and the records of
    blended then hold no entries, and the backward pass makes them again.
    """

    camera: DeviceArray
    size: tuple[int, int]
    visible: cull.Visible
    activations: mlp.Activations
    gaussians: neural.NeuralGaussians
    projected: project.Projected
    tiles: tiles.TileLists
    background: DeviceArray
    blended: blend.Blended
    groups: Groups | None = None

    @property
    def image(self) -> DeviceArray:
        """The picture (3, H, W) float32."""
        return self.blended.image

    @property
    def totals(self) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
        """How many visible anchors, Gaussians and tile entries there are, (1,) int64 each."""
        return self.visible.total, self.gaussians.total, self.tiles.total


@dataclass(frozen=True)
class Picture:
    """A rendered view without what a backward pass needs: image (3, H, W), and totals as a Frame's.

    image: float32, not clamped.
    """

    image: DeviceArray
    totals: tuple[DeviceArray, DeviceArray, DeviceArray]


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
