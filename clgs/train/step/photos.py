"""Photos and cameras on the device, ready to be rendered and compared."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from clgs.data.images import Pixels
from clgs.data.stored_photo import Color, Planes, composite
from clgs.data.view import View
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.render.frame import DeviceView
from clgs.train.config.settings import BACKGROUNDS


@dataclass(frozen=True)
class TrainingPhoto:
    """What one step trains on: the camera with its background, and the photo.

    photo (3, H, W) uint8, composited on the background, zero where it is masked; used (H, W) uint8
    of 0 and 1, None if nothing is masked.
    """

    view: DeviceView
    photo: DeviceArray
    used: DeviceArray | None


class TrainingPhotos:
    """Reduces and composites photos, if asked ahead of their steps; uploads each for its step."""

    def __init__(self, device: Device, views: list[View], background: str, near: float) -> None:
        """``background`` is "black", "white" or "random"; ``near`` of the cameras."""
        self._device, self._near = device, near
        self._views = views
        self._fixed = BACKGROUNDS.get(background)
        self._cameras: dict[tuple[int, int], DeviceArray] = {}
        self._background: tuple[Color, DeviceArray] | None = None
        self._worker = ThreadPoolExecutor(1, "photos")
        self._coming: dict[tuple[int, int], Future[Pixels | Planes]] = {}

    def color(self, rng: np.random.Generator) -> Color:
        """The background of the next step: the fixed one, or a new random one."""
        if self._fixed is not None:
            return self._fixed
        red, green, blue = (float(np.float32(value)) for value in rng.random(3))
        return red, green, blue

    def prepare(self, indices: Iterable[int], factor: int) -> None:
        """Let a thread read what :meth:`get` will be asked for next; forget other photos."""
        wanted = {(index, factor) for index in indices}
        for key in set(self._coming) - wanted:
            self._coming.pop(key).cancel()
        for index, _ in sorted(wanted - set(self._coming)):
            if not self._views[index].photo.has(self._fixed, factor):
                self._coming[index, factor] = self._worker.submit(self._read, index, factor)

    def get(self, index: int, background: Color, factor: int = 1) -> TrainingPhoto:
        """View ``index`` reduced ``factor`` times, composited on ``background``.

        Cameras stay on the device from their first use on.

        Raises:
            DataError: the photo can no longer be read.
        """
        camera, photo = self._views[index].camera.reduced(factor), self._views[index].photo
        if (index, factor) not in self._cameras:
            self._cameras[index, factor] = self._device.upload(camera.pack(self._near))
        if self._background is None or self._background[0] != background:
            self._background = background, self._device.upload(np.array(background, np.float32))
        packed, size = self._cameras[index, factor], (camera.width, camera.height)
        seen = DeviceView(packed, size, self._background[1])
        if self._fixed not in (None, background):
            planes = photo.planes(background, factor)
        else:
            coming = self._coming.pop((index, factor), None)
            found = self._read(index, factor) if coming is None else coming.result()
            planes = composite(found, background) if isinstance(found, Pixels) else found
        used = self._views[index].used(factor)
        if used is None:
            return TrainingPhoto(seen, self._device.upload_constant(planes), None)
        masked, mask = map(self._device.upload_constant, (planes * used, used))
        return TrainingPhoto(seen, masked, mask)

    def _read(self, index: int, factor: int) -> Pixels | Planes:
        """A photo as far as it can be made without knowing a random background."""
        photo = self._views[index].photo
        if self._fixed is None:
            return photo.reduced(factor)
        return photo.planes(self._fixed, factor, final=True)
