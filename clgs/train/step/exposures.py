"""The exposure of every training photo, learned together with the scene and not stored with it."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
        self.gradient = device.zeros((photos, 3, 4))
        """Gradient by the maps, in the rows of the photos that :meth:`backward` was called for."""
        # From the beginning of an epoch on, so that every photo was learned from equally often.
        views = config.steps * config.batch
        self._start = math.ceil(START * views / photos) * photos

    def learn_at(self, step: int, place: int = 0) -> bool:
        """Whether view ``place`` (from 0) of step number ``step`` (from 1) uses its map.

        Before, maps are identities.
        """
        return self._view(step, place) > self._start

    def _view(self, step: int, place: int) -> int:
        """The number of a view, from 1, of all that are looked at."""
        return (step - 1) * self._config.batch + place + 1

    def backward(
        self,
        maps: DeviceArray,
        image: DeviceArray,
        d_picture: DeviceArray,
        photo: int,
        stop: DeviceArray,
    ) -> DeviceArray:
        """The gradient by the render (3, H, W); ``stop`` is set if the map's is not finite."""
        weight = self._config.exposure_weight
        arrays = image, d_picture, maps
        d_image = exposure.backward(self._device, *arrays, photo, weight, self.gradient)
        adam.check_finite(self._device, [self.gradient], stop)
        return d_image

    def learn(
        self, exposures: ExposureMaps, photos: Sequence[int], step: int, stop: DeviceArray
    ) -> None:
        """Update the maps of the photos that step number ``step`` looked at, if they learn then."""
        maps, updates = exposures.maps, []
        rate = learning_rates(self._config, step, 1.0)["exposure"]
        trained = adam.Trained(maps, self.gradient, exposures.moments)
        for place, photo in enumerate(photos):
            if self.learn_at(step, place):
                seen = self._view(step, place) - self._start
                count = (seen - 1) // len(maps) + 1  # each is seen once in an epoch
                part = slice(exposure.MAP_SIZE * photo, exposure.MAP_SIZE * (photo + 1))
                updates.append(adam.Update(trained, adam.factors(rate, count), part))
        if updates:
            self._adam.step(self._device, updates, stop)
            exposure.centre(self._device, maps, stop)
