"""The exposure of every training photo, learned together with the scene and not stored with it."""

from __future__ import annotations

import math

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, exposure
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import ExposureMaps
from clgs.train.step import numpy_adam
from clgs.train.step.schedule import learning_rates

START = 0.2
"""The maps learn after this share of the steps: a blurred scene fits dull photos best."""


class ExposureTerm:
    """Exposes renders by the maps of their photos, and lets the maps learn."""

    def __init__(self, device: Device, config: TrainConfig, photos: int) -> None:
        """Learn the exposures of ``photos`` training photos."""
        self._device, self._config = device, config
        self._adam = numpy_adam if config.optimizer == "numpy" else adam
        self._gradient = device.zeros((photos, 3, 4))
        # From the beginning of an epoch on, so that every photo was learned from equally often.
        self._start = math.ceil(START * config.steps / photos) * photos

    def learn_at(self, step: int) -> bool:
        """Whether step number ``step`` (from 1) uses the maps; before, they are identities."""
        return step > self._start

    def backward(
        self,
        exposures: ExposureMaps,
        image: DeviceArray,
        d_picture: DeviceArray,
        photo: int,
        stop: DeviceArray,
    ) -> DeviceArray:
        """The gradient by the render (3, H, W); ``stop`` is set if the map's is not finite."""
        weight = self._config.exposure_weight
        arrays = image, d_picture, exposures.maps
        d_image = exposure.backward(self._device, *arrays, photo, weight, self._gradient)
        adam.check_finite(self._device, [self._gradient], stop)
        return d_image

    def learn(self, exposures: ExposureMaps, photo: int, step: int, stop: DeviceArray) -> None:
        """Update the map of a photo that step number ``step`` trained on, if they learn then."""
        if not self.learn_at(step):
            return
        maps = exposures.maps
        count = (step - self._start - 1) // len(maps) + 1  # each is seen once in an epoch
        rate = learning_rates(self._config, step, 1.0)["exposure"]
        trained = adam.Trained(maps, self._gradient, exposures.moments)
        part = slice(exposure.MAP_SIZE * photo, exposure.MAP_SIZE * (photo + 1))
        self._adam.step(self._device, [adam.Update(trained, adam.factors(rate, count), part)], stop)
        exposure.centre(self._device, maps, stop)
