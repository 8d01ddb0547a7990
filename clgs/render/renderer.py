"""Render pictures of a finished scene."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.render.frame import upload_scene
from clgs.render.pipeline import render_forward
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene


class Renderer:
    """Keeps a scene on a device and renders it from any camera."""

    def __init__(self, device: Device, scene: Scene) -> None:
        """Upload ``scene`` once."""
        self._device, self._settings = device, scene.settings
        self._scene = upload_scene(device, scene)

    def render(self, camera: Camera) -> npt.NDArray[np.float32]:
        """Picture (3, H, W) float32 from a camera in scene units; not clamped to [0, 1]."""
        frame = render_forward(self._device, self._scene, camera, self._settings)
        return np.asarray(self._device.download(frame.image), np.float32)


def render_view(
    scene: Scene, camera: Camera, device: Device | None = None
) -> npt.NDArray[np.float32]:
    """One picture (3, H, W) float32 of a scene; see :class:`Renderer` for many."""
    return Renderer(device or Device(), scene).render(camera)
