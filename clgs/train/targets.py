"""Photos on the device, ready to be compared with renders."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import View, composite
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device

BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}


class Targets:
    """Composites photos on a background; fixed ones are uploaded once and kept."""

    def __init__(self, device: Device, views: list[View], background: str) -> None:
        """``background`` is "black", "white" or "random" (a new colour each step)."""
        self._device = device
        self._views = views
        self._fixed = BACKGROUNDS.get(background)
        self._kept: dict[int, DeviceArray] = {}

    def get(
        self, index: int, rng: np.random.Generator
    ) -> tuple[DeviceArray, tuple[float, float, float]]:
        """Photo ``index`` as (3, H, W) uint8 on the device, and the background it lies on."""
        if self._fixed is None:
            red, green, blue = (float(np.float32(value)) for value in rng.random(3))
            return self._upload(index, (red, green, blue)), (red, green, blue)
        if index not in self._kept:
            self._kept[index] = self._upload(index, self._fixed)
        return self._kept[index], self._fixed

    def _upload(self, index: int, background: tuple[float, float, float]) -> DeviceArray:
        return self._device.upload(planar(self._views[index], background))


def planar(view: View, background: tuple[float, float, float]) -> npt.NDArray[np.uint8]:
    """A photo composited on ``background``, (3, H, W) uint8."""
    return composite(view, np.array(background))
