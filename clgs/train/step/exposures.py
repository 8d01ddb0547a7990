"""The exposure of every training photo, learned beside the scene and not stored with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, exposure
from clgs.train.config import TrainConfig
from clgs.train.step import numpy_adam
from clgs.train.step.schedule import learning_rates

START = 0.2
"""Share of the steps before the maps learn: a scene that is still blurred fits dull photos best."""


class Exposures:
    """Affine maps of colors, one for each training photo, and their Adam moments."""

    def __init__(self, device: Device, config: TrainConfig, photos: int) -> None:
        """Maps of so many photos, which change nothing yet."""
        self._device, self._config = device, config
        self._adam = numpy_adam if config.optimizer == "numpy" else adam
        self._maps = exposure.identity(device, photos)
        self._moments = adam.zero_moments(device, self._maps)
        self._gradient = device.zeros(self._maps.shape)
        # From the beginning of an epoch on, so that every photo was learned from equally often.
        self._start = math.ceil(START * config.steps / photos) * photos

    def learn_at(self, step: int) -> bool:
        """Whether step number ``step`` (from 1) uses the maps; before, they are identities."""
        return step > self._start

    def items(self) -> Iterator[tuple[str, DeviceArray]]:
        """(name, array) of all that a checkpoint keeps."""
        yield "exposure", self._maps
        for which, array in self._moments.items():
            yield f"{which}.exposure", array

    def restore(self, arrays: Mapping[str, DeviceArray]) -> None:
        """Take over what :meth:`items` gave."""
        self._maps = arrays["exposure"]
        self._moments = adam.Moments(arrays["first.exposure"], arrays["second.exposure"])

    def expose(self, image: DeviceArray, photo: int) -> DeviceArray:
        """The render (3, H, W) float32 with the exposure of a photo."""
        return exposure.forward(self._device, image, self._maps, photo)

    def backward(
        self, image: DeviceArray, d_picture: DeviceArray, photo: int, stop: DeviceArray
    ) -> DeviceArray:
        """The gradient by the render (3, H, W); ``stop`` is set if the map's is not finite."""
        weight = self._config.exposure_weight
        arrays = image, d_picture, self._maps
        d_image = exposure.backward(self._device, *arrays, photo, weight, self._gradient)
        adam.check_finite(self._device, [self._gradient], stop)
        return d_image

    def step(self, photo: int, step: int, stop: DeviceArray) -> None:
        """Update the map of a photo that step number ``step`` trained on, if they learn then."""
        if not self.learn_at(step):
            return
        count = (step - self._start - 1) // len(self._maps) + 1  # each is seen once in an epoch
        rate = learning_rates(self._config, step, 1.0)["exposure"]
        trained = adam.Trained(self._maps, self._gradient, self._moments)
        part = slice(exposure.MAP_SIZE * photo, exposure.MAP_SIZE * (photo + 1))
        self._adam.step(self._device, trained, adam.factors(rate, count), stop, part)
        exposure.centre(self._device, self._maps, stop)
