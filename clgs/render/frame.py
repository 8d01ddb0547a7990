"""What the stages of a render pass on, and what its backward pass returns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, mlp, neural, project
from clgs.ops.scan import EXACT
from clgs.ops.tiles import TileLists
from clgs.scene.anchors import DeviceAnchors
from clgs.scene.camera import Camera
from clgs.scene.gaussians import DeviceGaussians
from clgs.scene.scene import RenderSettings, Scene, SplatScene


@dataclass(frozen=True)
class DeviceScene:
    """Parameters of a scene on the device, float32: the anchors, and the MLPs' weights (13710,)."""

    anchors: DeviceAnchors
    weights: DeviceArray

    def items(self) -> Iterator[tuple[str, DeviceArray]]:
        """(name, array) of the anchors' tensors, then of the weights."""
        yield from self.anchors.items()
        yield "weights", self.weights


Drawable = DeviceScene | DeviceGaussians
"""What pictures are made of."""


@dataclass(frozen=True)
class DeviceView:
    """A camera of ``size`` (width, height) pixels and the color behind the scene.

    camera (26,) float32 from ``Camera.pack``; background (3,) float32.
    """

    camera: DeviceArray
    size: tuple[int, int]
    background: DeviceArray


@dataclass(frozen=True)
class Room:
    """Lengths of the arrays of a frame: visible anchors, Gaussians and tile entries.

    What there is more of is left out. EXACT makes an array as long as it needs to be, for which the
    host waits for the device.
    """

    visible: int = EXACT
    gaussians: int = EXACT
    entries: int = EXACT

    def holds(self, needed: Room) -> bool:
        """Whether nothing is left out if so much is ``needed``."""
        return all(n <= room for n, room in zip(astuple(needed), astuple(self), strict=True))

    def grown(self, needed: Room) -> Room:
        """The room for the next frame, in which nothing waits for the device.

        A length that is EXACT or less than ``needed`` becomes that and a quarter more.
        """
        pairs = zip(astuple(needed), astuple(self), strict=True)
        return Room(*(room if n <= room != EXACT else n + n // 4 + 1024 for n, room in pairs))


EXACT_ROOM = Room()


@dataclass(frozen=True)
class Groups:
    """``rows``: first and end of the rows of tiles of each group; entries of the largest group."""

    rows: tuple[tuple[int, int], ...]
    entries: int


@dataclass(frozen=True)
class Frame:
    """One rendered view: what every stage made, for the backward pass.

    groups: the rows of tiles that were drawn at a time, if a memory budget asked for it; tiles and
    the records of ``blended`` then hold no entries, and the backward pass makes them again.
    """

    view: DeviceView
    visible: cull.Visible
    activations: mlp.Activations
    gaussians: neural.NeuralGaussians
    projected: project.Projected
    blended: blend.Blended
    groups: Groups | None

    @property
    def image(self) -> DeviceArray:
        """The picture (3, H, W) float32."""
        return self.blended.image

    @property
    def tiles(self) -> TileLists:
        """The lists that were blended."""
        return self.blended.tiles

    @property
    def totals(self) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
        """How many visible anchors, Gaussians and tile entries there are, (1,) int64 each."""
        return self.visible.total, self.gaussians.total, self.tiles.total

    def needed(self, device: Device) -> Room:
        """The same on the host; waits for the device."""
        return Room(*(int(device.download(total)[0]) for total in self.totals))


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
    return DeviceScene(scene.anchors.map(device.upload), device.upload(scene.mlps.flat))


def upload_drawable(device: Device, scene: Scene | SplatScene) -> Drawable:
    """Copy what is drawn of a scene to the device."""
    if isinstance(scene, SplatScene):
        return scene.gaussians.map(device.upload)
    return upload_scene(device, scene)


def upload_view(device: Device, camera: Camera, settings: RenderSettings) -> DeviceView:
    """Copy a camera and the settings of a render to the device."""
    return DeviceView(
        device.upload(camera.pack(settings.near)),
        (camera.width, camera.height),
        device.upload(np.array(settings.background, np.float32)),
    )
