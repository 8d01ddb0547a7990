"""One view on one device: the photo, the picture, the loss, and the gradients of what was drawn.

The exposure of every training photo is learned together with the scene and not stored with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from clgs.data.dataset import Dataset
from clgs.data.images import Pixels
from clgs.data.view import Color, Planes, View, composite
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import adam, density, exposure, loss, mask
from clgs.options import BACKGROUNDS
from clgs.render.frame import DeviceScene, DeviceView, Frame, Room, SceneGradients
from clgs.render.rasterise import check_room, rasterise, rasterise_backward
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import ExposureMaps
from clgs.train.step import numpy_adam
from clgs.train.step.grow_and_prune import observes, seen_view
from clgs.train.step.schedule import learning_rates, reduction

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


@dataclass(frozen=True)
class ViewInput:
    """A training view by its number, and the color behind it."""

    index: int
    background: Color


@dataclass(frozen=True)
class Look:
    """What a look at a view leaves on the device, and its pending downloads.

    totals: numbers of visible anchors, Gaussians and tile entries, (3,) int64; partials: of the
    loss, float32; seen: for the statistics, None if they are not taken; d_maps (P, 3, 4): its row
    of the photo is the gradient of that exposure, None if it does not learn; frame: None if the
    look was had on another device.
    """

    gradients: SceneGradients
    loss: loss.LaterValue
    partials: DeviceArray
    totals: Download
    seen: density.SeenView | None
    d_maps: DeviceArray | None
    frame: Frame | None


class Looks:
    """Looks at training views on one device."""

    def __init__(self, device: Device, dataset: Dataset, config: TrainConfig) -> None:
        """Prepare the looks of a run; ``config`` is resolved for the dataset."""
        self._device, self._config = device, config
        self.photos = TrainingPhotos(device, dataset.train, config.step_background, config.near)
        self.exposure = ExposureTerm(device, config, len(dataset.train))
        self.stop = adam.stop_flag(device)
        self.options = config.render_options()
        self._mlps_learn = config.learning_box is None

    def enqueue(
        self,
        scene: DeviceScene,
        maps: DeviceArray | None,
        step: int,
        view: ViewInput,
        room: Room,
    ) -> Look:
        """Enqueue the look at ``view`` in step number ``step``.

        ``stop`` is set if something lacks room, or the gradient of the exposure is not finite.

        Args:
            scene: what is drawn, on this device.
            maps: exposures (P, 3, 4) float32 of all photos; None if they do not learn yet.
            step: from 1.
            view: what is looked at.
            room: for what is drawn.
        """
        device, weight = self._device, self._config.volume_weight or 0.0
        target = self.target(step, view)
        frame = rasterise(device, scene, target.view, self.options, room)
        totals = check_room(device, frame, self.stop)
        compared, d_image = self._compare(frame, maps, target, view.index)
        gradients = rasterise_backward(device, scene, frame, d_image, weight, self._mlps_learn)
        return Look(
            gradients=gradients,
            loss=compared.value_later(device),
            partials=compared.sums,
            totals=device.download_later(totals),
            seen=seen_view(frame, gradients) if observes(self._config, step) else None,
            d_maps=None if maps is None else self.exposure.gradient,
            frame=frame,
        )

    def target(self, step: int, view: ViewInput) -> TrainingPhoto:
        """The camera and the photo of a view in a step."""
        return self.photos.get(view.index, view.background, reduction(self._config, step))

    def _compare(
        self, frame: Frame, maps: DeviceArray | None, target: TrainingPhoto, index: int
    ) -> tuple[loss.Loss, DeviceArray]:
        """The loss and its gradient by the render."""
        device, config, photo, used = self._device, self._config, target.photo, target.used
        picture = frame.image
        if maps is not None:
            with device.stage("exposure"):
                picture = exposure.forward(device, picture, maps, index)
        with device.stage("loss forward"):
            picture = picture if used is None else mask.forward(device, picture, used)
            weights = loss.Weights(config.l1_weight, config.ssim_weight)
            compared = loss.forward(device, picture, photo, weights)
        with device.stage("loss backward"):
            gradient = loss.backward(device, picture, photo, compared)
            gradient = gradient if used is None else mask.backward(device, gradient, used)
        if maps is not None:
            with device.stage("exposure"):
                gradient = self.exposure.backward(maps, frame.image, gradient, index, self.stop)
        return compared, gradient
