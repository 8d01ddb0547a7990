"""One view on one device: the picture, the loss, and the gradients of what was drawn."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.data.dataset import Dataset
from clgs.data.stored_photo import Color
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import adam, density, exposure, loss, mask
from clgs.render.frame import DeviceScene, Frame, Room, SceneGradients
from clgs.render.rasterise import check_room, rasterise, rasterise_backward
from clgs.train.config import TrainConfig
from clgs.train.density.grow_and_prune import observes, seen_view
from clgs.train.step.exposures import ExposureTerm
from clgs.train.step.photos import TrainingPhoto, TrainingPhotos
from clgs.train.step.schedule import reduction


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
        gradients = rasterise_backward(device, scene, frame, d_image, weight)
        return Look(
            gradients=gradients,
            loss=compared.value_later(device),
            partials=compared.sums.partials,
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
