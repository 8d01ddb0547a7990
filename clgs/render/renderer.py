"""Render pictures of a finished scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_type
from clgs.errors import BudgetError
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions, render_options
from clgs.render.frame import (
    EXACT_ROOM,
    DeviceView,
    Drawable,
    RenderedView,
    upload_drawable,
    upload_view,
)
from clgs.render.rasterise import draw_depth, largest_depth, rasterise, with_enough_room
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings, Scene, SplatScene

CAMERA_REMEDY = "of a view give view.camera"
MIB = 2**20

Image = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Depth:
    """Depth and opacity of what a camera sees, (H, W) float32.

    depth: mean camera z, scene units, of what is blended into the pixel, each by its weight, or 0
    if that is nothing; opacity: 1 - the transmittance that is left, 0 to 1.
    """

    depth: Image
    opacity: Image


class Renderer:
    """Keeps a scene on a device and renders it from any camera."""

    def __init__(
        self, device: Device, scene: Scene | SplatScene, options: RenderOptions = DEFAULT
    ) -> None:
        """Upload ``scene`` once; ``options`` from :func:`clgs.options.render_options`.

        Raises:
            TypeError: an argument is of another class.
        """
        check_type("device", device, Device, "clgs.Device() opens one")
        if not isinstance(scene, SplatScene):
            check_type("scene", scene, Scene, "of a quantised one give scene.dequantize()")
        check_type("options", options, RenderOptions, "clgs.render_options(accuracy) makes some")
        self._keep(device, upload_drawable(device, scene), scene.settings, options)

    @classmethod
    def of_device_scene(
        cls,
        device: Device,
        scene: Drawable,
        settings: RenderSettings,
        options: RenderOptions = DEFAULT,
    ) -> Renderer:
        """A renderer of a scene that lies on the device already."""
        renderer = cls.__new__(cls)
        renderer._keep(device, scene, settings, options)
        return renderer

    def _keep(
        self, device: Device, scene: Drawable, settings: RenderSettings, options: RenderOptions
    ) -> None:
        self._device, self._scene, self._settings = device, scene, settings
        self._options, self._room = options, EXACT_ROOM

    def check_budget(self, views: Iterable[tuple[str, Camera]]) -> None:
        """Refuse a memory budget that is too small for one of ``views``, (name, camera).

        Nothing is drawn; a view takes the time of the stages up to ``project``.

        Raises:
            BudgetError: names the view that needs most, and the least budget for all of them.
        """
        if self._options.max_memory is None:
            return
        no_memory = replace(self._options, max_memory=0)
        needs = {}
        for name, camera in views:
            try:
                rasterise(self._device, self._scene, self._view(camera), no_memory, keep=False)
                needs[name] = 0
            except BudgetError as error:
                needs[name] = error.needed
        worst = max(needs, key=needs.__getitem__, default="")
        if needs and needs[worst] > self._options.max_memory:
            least = -(-needs[worst] // MIB)
            raise BudgetError(
                f"view {worst}: a row of tiles needs {needs[worst] / MIB:.1f} MiB; {least} MiB are "
                f"enough for all {len(needs)} views: give --max-memory {least}, a smaller image or "
                "fewer Gaussians",
                needs[worst],
            )

    def render(self, camera: Camera) -> Image:
        """Picture (3, H, W) float32 from a camera in scene units; not clamped to [0, 1].

        Raises:
            TypeError: ``camera`` is of another class.
        """
        picture = self._drawn(partial(rasterise, keep=False), camera)
        image = np.asarray(self._device.hand_over(picture.image), np.float32)
        return enlarge(image, camera.width, camera.height)

    def depth(self, camera: Camera) -> Depth:
        """Depth and opacity from a camera in scene units.

        Raises:
            TypeError: ``camera`` is of another class.
        """
        picture, device = self._drawn(draw_depth, camera), self._device
        sums = np.asarray(device.download(picture.image)[:2], np.float32)
        left = np.asarray(device.download(picture.blended.transmittance)[None], np.float32)
        planes = enlarge(np.concatenate([sums, left]), camera.width, camera.height)
        weight = np.where(planes[1] > 0, planes[1], 1)
        unit = np.float32(largest_depth(device, picture.projected))
        depth = np.where(planes[1] > 0, planes[0] / weight * unit, 0)
        return Depth(depth.astype(np.float32), np.asarray(1 - planes[2], np.float32))

    def _drawn(self, draw: Callable[..., RenderedView], camera: Camera) -> RenderedView:
        """What ``rasterise`` or ``draw_depth`` makes, with as much room as it needs."""
        check_type("camera", camera, Camera, CAMERA_REMEDY)
        drawn = self._scene, self._view(camera), self._options
        picture, self._room = with_enough_room(draw, self._device, *drawn, self._room)
        return picture

    def _view(self, camera: Camera) -> DeviceView:
        """The view from ``camera`` in the size that is drawn."""
        reduced = camera.reduced(self._options.accuracy.downscale)
        return upload_view(self._device, reduced, self._settings)


def render_view(
    scene: Scene | SplatScene,
    camera: Camera,
    device: Device | None = None,
    accuracy: str = "parity",
) -> Image:
    """One picture (3, H, W) float32 of a scene; see :class:`Renderer` for many.

    ``accuracy`` is "exact", "parity", "fast" or "preview".

    Raises:
        TypeError: an argument is of another class.
    """
    check_type("camera", camera, Camera, CAMERA_REMEDY)
    return Renderer(device or Device(), scene, render_options(accuracy)).render(camera)


def enlarge(image: Image, width: int, height: int) -> Image:
    """The planar picture (3, h, w) float32 as (3, height, width): bilinear, edges continued.

    Pixel centres lie at +0.5 in both, so that nothing is shifted.
    """
    if image.shape[1:] == (height, width):
        return image
    low, high, share = _neighbours(image.shape[1], height)
    rows = image[:, low] + (image[:, high] - image[:, low]) * share[:, None]
    low, high, share = _neighbours(image.shape[2], width)
    return np.asarray(rows[..., low] + (rows[..., high] - rows[..., low]) * share, np.float32)


def _neighbours(
    inputs: int, outputs: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Image]:
    """The inputs on both sides of each output, and the share of the second."""
    place = np.clip((np.arange(outputs) + 0.5) * (inputs / outputs) - 0.5, 0, inputs - 1)
    low = np.floor(place).astype(np.int64)
    return low, np.minimum(low + 1, inputs - 1), (place - low).astype(np.float32)
