"""What a render is made of on the device, and what it and its backward pass return."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, mlp, neural, project
from clgs.ops.scan import EXACT
from clgs.ops.tiles import TileLists
from clgs.scene.anchors import DeviceAnchors
from clgs.scene.camera import UNKNOWN, Camera, PhotoRange
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
"""What can be drawn: anchors with their MLPs, or ordinary Gaussians."""


@dataclass(frozen=True)
class DeviceView:
    """A camera of ``size`` (width, height) pixels and the color behind the scene.

    camera (26,) float32 from ``Camera.pack``; background (3,) float32; screen: how it blurs anchors
    in pictures without a backward pass.
    """

    camera: DeviceArray
    size: tuple[int, int]
    background: DeviceArray
    screen: project.Screen = project.USUAL_SCREEN


@dataclass(frozen=True)
class Room:
    """Lengths of a frame's arrays: of visible anchors, of Gaussians and of entries of tile lists.

    What does not fit is left out. An array whose length is EXACT is as long as it needs to be; the
    host waits for the device to learn that length.
    """

    visible: int = EXACT
    gaussians: int = EXACT
    entries: int = EXACT

    def holds(self, needed: Room) -> bool:
        """Whether all that is ``needed`` fits."""
        return all(n <= length for n, length in zip(astuple(needed), astuple(self), strict=True))

    def grown(self, needed: Room) -> Room:
        """The room for further frames, in which nothing waits for the device.

        A length that is EXACT or too small becomes what is ``needed``, and a quarter more.
        """
        pairs = zip(astuple(needed), astuple(self), strict=True)
        return Room(*(length if n <= length != EXACT else n + n // 4 + 1024 for n, length in pairs))


EXACT_ROOM = Room()


@dataclass(frozen=True)
class TileGroups:
    """Groups of rows of tiles that are drawn one after the other, to keep to a memory budget.

    rows: first and end of the rows of each group, at least two groups; longest: entries of the
    largest group; total: entries of all groups.
    """

    rows: tuple[tuple[int, int], ...]
    longest: int
    total: int


@dataclass(frozen=True)
class RenderedView:
    """A rendered view, of anchors or of ordinary Gaussians.

    room: the lengths of its arrays; totals: how many visible anchors, Gaussians and tile entries
    there are, (1,) int64 each, without anchors the number of Gaussians twice; groups: None if the
    picture was drawn at once. If it was drawn in groups, its tile lists and records are empty, and
    the backward pass makes them again. gaussians: None if anchors were drawn by the fused stage.
    """

    view: DeviceView
    room: Room
    totals: tuple[DeviceArray, DeviceArray, DeviceArray]
    projected: project.Projected
    blended: blend.Blended
    groups: TileGroups | None
    gaussians: neural.Gaussians | None

    @property
    def image(self) -> DeviceArray:
        """The picture (3, H, W) float32, not clamped."""
        return self.blended.image

    @property
    def tiles(self) -> TileLists:
        """The lists that were blended."""
        return self.blended.tiles

    def needed(self, device: Device) -> Room:
        """The totals on the host; waits for the device."""
        totals = [device.download_later(total) for total in self.totals]
        return Room(*(int(total.get()[0]) for total in totals))


@dataclass(frozen=True)
class Frame(RenderedView):
    """A picture of anchors, with all that its backward pass needs."""

    gaussians: neural.NeuralGaussians
    activations: mlp.Activations


@dataclass(frozen=True)
class SceneGradients:
    """Gradients of the loss by the trained parameters, dense over all anchors, float32.

    d_offset (A, K, 3), d_feature (A, F), d_scaling (A, 6), d_weights (13710,); and d_projected, by
    what the stage ``project`` made.
    """

    d_offset: DeviceArray
    d_feature: DeviceArray
    d_scaling: DeviceArray
    d_weights: DeviceArray
    d_projected: project.ProjectedGradients

    @property
    def d_mean2d(self) -> DeviceArray:
        """(N, 2) by the centres on the screen, in pixels, which drives densification."""
        return self.d_projected.d_mean2d


@dataclass(frozen=True)
class StoredGradients:
    """Gradients of the loss, float32: by the arrays of the ordinary Gaussians, and d_projected."""

    d_stored: DeviceGaussians
    d_projected: project.ProjectedGradients


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
        screen_of(camera, settings.photos),
    )


def screen_of(camera: Camera, photos: PhotoRange) -> project.Screen:
    """The screen of ``camera`` for a scene that was learned from ``photos``."""
    if photos == UNKNOWN:
        return project.USUAL_SCREEN
    least, greatest = photos[:2]
    sizes = [focal / min(max(focal, least), greatest) for focal in (camera.fx, camera.fy)]
    # if pixels are not square, the blur is that of the axis on which the size differs less
    return project.Screen(*photos[2:], max(1.0, min(sizes)) * min(1.0, max(sizes)))
