"""Photos and cameras on the device, ready to be rendered and compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import View, composite
from clgs.data.images import Pixels, box_downscale
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.render.frame import DeviceView, upload_view
from clgs.scene.scene import RenderSettings

BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}
Color = tuple[float, float, float]


@dataclass(frozen=True)
class Target:
    """What one step trains on: the camera with its background, and the photo.

    photo (3, H, W) uint8, composited on the background.
    """

    view: DeviceView
    photo: DeviceArray


class Targets:
    """Reduces and composites photos; what does not change is made and uploaded once and kept."""

    def __init__(self, device: Device, views: list[View], background: str, near: float) -> None:
        """``background`` is "black", "white" or "random"; ``near`` of the cameras."""
        self._device, self._near = device, near
        self._views = views
        self._fixed = BACKGROUNDS.get(background)
        self._factor = 1
        self._reduced: dict[int, View] = {}
        self._kept: dict[int, Target] = {}

    def color(self, rng: np.random.Generator) -> Color:
        """The background of the next step: the fixed one, or a new random one."""
        if self._fixed is not None:
            return self._fixed
        red, green, blue = (float(np.float32(value)) for value in rng.random(3))
        return red, green, blue

    def get(self, index: int, background: Color, factor: int = 1) -> Target:
        """View ``index`` reduced ``factor`` times, composited on ``background``."""
        if factor != self._factor:
            self._factor = factor
            self._reduced.clear()
            self._kept.clear()
        if index not in self._reduced:
            self._reduced[index] = reduced(self._views[index], factor)
        view = self._reduced[index]
        kept = self._kept.get(index)
        if kept is None or background != self._fixed:
            kept = self._kept[index] = self._upload(view, background, kept)
        return kept

    def _upload(self, view: View, background: Color, before: Target | None) -> Target:
        """A new target; the parts that no background changes are those of ``before``."""
        if before is None:
            seen = upload_view(self._device, view.camera, RenderSettings(background, self._near))
        else:
            color = self._device.upload(np.array(background, np.float32))
            seen = replace(before.view, background=color)
        if before is not None and view.alpha is None:
            return Target(seen, before.photo)
        return Target(seen, self._device.upload(planar(view, background)))


def reduced(view: View, factor: int) -> View:
    """A view on a raster ``factor`` times smaller, by box means."""
    if factor == 1:
        return view
    pixels = box_downscale(Pixels(view.image, view.alpha), factor)
    return View(view.name, view.camera.reduced(factor), pixels.color, pixels.alpha)


def planar(view: View, background: Color) -> npt.NDArray[np.uint8]:
    """A photo composited on ``background``, (3, H, W) uint8."""
    return composite(view, np.array(background))
