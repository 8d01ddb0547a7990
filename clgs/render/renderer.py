"""Render pictures of a finished scene."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions, render_options
from clgs.render.budget import check_budget
from clgs.render.enlarge import enlarge
from clgs.render.frame import Capacity, DeviceScene, upload_scene, upload_view
from clgs.render.pipeline import draw
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings, Scene


class Renderer:
    """Keeps a scene on a device and renders it from any camera."""

    def __init__(self, device: Device, scene: Scene, options: RenderOptions = DEFAULT) -> None:
        """Upload ``scene`` once; ``options`` from :func:`clgs.options.render_options`."""
        self._keep(device, upload_scene(device, scene), scene.settings, options)

    @classmethod
    def of_device_scene(
        cls,
        device: Device,
        scene: DeviceScene,
        settings: RenderSettings,
        options: RenderOptions = DEFAULT,
    ) -> Renderer:
        """A renderer of a scene that lies on the device already."""
        renderer = cls.__new__(cls)
        renderer._keep(device, scene, settings, options)
        return renderer

    def _keep(
        self, device: Device, scene: DeviceScene, settings: RenderSettings, options: RenderOptions
    ) -> None:
        self._device, self._scene, self._settings = device, scene, settings
        self._options = options
        self._capacity: Capacity | None = None

    def check_budget(self, views: Iterable[tuple[str, Camera]]) -> None:
        """Refuse a memory budget that is too small for one of ``views``, (name, camera).

        Raises:
            BudgetError: names the view that needs most, and the least budget for all of them.
        """
        check_budget(self._device, self._scene, views, self._settings, self._options)

    def render(self, camera: Camera) -> npt.NDArray[np.float32]:
        """Picture (3, H, W) float32 from a camera in scene units; not clamped to [0, 1]."""
        device, options = self._device, self._options
        view = upload_view(device, camera.reduced(options.accuracy.downscale), self._settings)
        while True:
            picture = draw(device, self._scene, view, options, self._capacity)
            totals = [device.download_later(total) for total in picture.totals]
            image = np.asarray(device.hand_over(picture.image), np.float32)
            needed = Capacity(*(int(total.get()[0]) for total in totals))
            if self._holds(needed):
                return enlarge(image, camera.width, camera.height)

    def _holds(self, needed: Capacity) -> bool:
        """Whether the last picture had room; makes more where not, and after the first one.

        Arrays of the same size every time are the same memory every time, and nothing is waited
        for between the stages.
        """
        made_to_measure = self._capacity is None
        before = self._capacity or Capacity(0, 0, 0)
        self._capacity = before.grown(needed)
        return made_to_measure or self._capacity == before


def render_view(
    scene: Scene, camera: Camera, device: Device | None = None, accuracy: str = "parity"
) -> npt.NDArray[np.float32]:
    """One picture (3, H, W) float32 of a scene; see :class:`Renderer` for many.

    ``accuracy`` is "exact", "parity", "fast" or "preview".
    """
    return Renderer(device or Device(), scene, render_options(accuracy)).render(camera)
