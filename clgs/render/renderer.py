"""Render pictures of a finished scene."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions, render_options
from clgs.render.enlarge import enlarge
from clgs.render.frame import DeviceScene, upload_scene
from clgs.render.pipeline import render_forward
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings, Scene


class Renderer:
    """Keeps a scene on a device and renders it from any camera."""

    def __init__(self, device: Device, scene: Scene, options: RenderOptions = DEFAULT) -> None:
        """Upload ``scene`` once; ``options`` from :func:`clgs.options.render_options`."""
        self._device, self._settings, self._options = device, scene.settings, options
        self._scene = upload_scene(device, scene)

    def render(self, camera: Camera) -> npt.NDArray[np.float32]:
        """Picture (3, H, W) float32 from a camera in scene units; not clamped to [0, 1]."""
        return render_picture(self._device, self._scene, camera, self._settings, self._options)


def render_picture(
    device: Device,
    scene: DeviceScene,
    camera: Camera,
    settings: RenderSettings,
    options: RenderOptions = DEFAULT,
) -> npt.NDArray[np.float32]:
    """Picture (3, H, W) float32 of a scene that lies on the device; see :class:`Renderer`."""
    small = camera.reduced(options.accuracy.downscale)
    frame = render_forward(device, scene, small, settings, options)
    image = np.asarray(device.download(frame.image), np.float32)
    return enlarge(image, camera.width, camera.height)


def render_view(
    scene: Scene, camera: Camera, device: Device | None = None, accuracy: str = "parity"
) -> npt.NDArray[np.float32]:
    """One picture (3, H, W) float32 of a scene; see :class:`Renderer` for many.

    ``accuracy`` is "exact", "parity", "fast" or "preview".
    """
    return Renderer(device or Device(), scene, render_options(accuracy)).render(camera)
