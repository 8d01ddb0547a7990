"""One training step: all of its work is put in the device's queue, and waited for later."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from clgs.data.dataset import Dataset
from clgs.data.stored_photo import Color
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import adam, exposure, loss, mask, scan
from clgs.render.frame import EXACT_ROOM, Frame, Room
from clgs.render.rasterise import check_room, rasterise, rasterise_backward
from clgs.train.config import TrainConfig
from clgs.train.density.grow_and_prune import observe, replaces_anchors
from clgs.train.rate.rate_term import RateTerm
from clgs.train.state.rounding import Rounding
from clgs.train.state.run_state import RunState
from clgs.train.step.exposures import ExposureTerm
from clgs.train.step.optimizer import Optimizer
from clgs.train.step.photos import TrainingPhoto, TrainingPhotos
from clgs.train.step.schedule import reduction


@dataclass(frozen=True)
class StepInput:
    """What a step needs in addition to the state of the run: its number, view and background."""

    step: int
    index: int
    background: Color


@dataclass(frozen=True)
class Enqueued:
    """A step in the device's queue, and its pending downloads.

    stop (1,) int32: not 0 if the step, or one before it, changed nothing because it lacked room or
    met a number that is not finite; totals: numbers of visible anchors, Gaussians and tile entries,
    (3,) int64; room: the room there was for them;
    rate_bits: per anchor, if the rate proxy ran; frame: if the host needs it to change the anchors.
    """

    given: StepInput
    loss: loss.LaterValue
    stop: Download
    totals: Download
    room: Room
    rate_bits: float | None
    frame: Frame | None

    @property
    def done(self) -> bool:
        """Whether the step, and all before it, changed the parameters; waits for it."""
        return int(self.stop.get()[0]) == 0

    def needed(self) -> Room:
        """How many visible anchors, Gaussians and entries there were; waits for the step."""
        return Room(*map(int, self.totals.get()))

    def lacked_room(self) -> bool:
        """Whether more was needed than there was room for; waits for the step."""
        return bool(int(self.stop.get()[0]) & scan.LACKS_ROOM)


class StepQueue:
    """Enqueues steps. Once its stop flag is set they change nothing.

    With ``room`` EXACT_ROOM a step waits for the device three times.
    """

    def __init__(
        self, device: Device, dataset: Dataset, config: TrainConfig, rounding: Rounding
    ) -> None:
        """Prepare the steps of a run; ``config`` is resolved for the dataset."""
        self._device, self._config, self._rounding = device, config, rounding
        self._optimizer = Optimizer(device, config, dataset.radius)
        self._photos = TrainingPhotos(device, dataset.train, config.step_background, config.near)
        self._exposure = ExposureTerm(device, config, len(dataset.train))
        self._rate = RateTerm(device, config)
        self._stop = adam.stop_flag(device)
        self.options = config.render_options()
        self.room = EXACT_ROOM
        self._sizes = self.room, 0

    def next_input(self, state: RunState, step: int) -> StepInput:
        """Take the view and the background of step number ``step`` from ``state``."""
        return StepInput(step, state.views.next(), self._photos.color(state.rng))

    def prepare(self, indices: Iterable[int], step: int) -> None:
        """Have the photos of the steps from number ``step`` on read ahead of them."""
        self._photos.prepare(indices, reduction(self._config, step))

    def clear(self) -> None:
        """Let the steps enqueued from now on change the parameters again."""
        self._device.fill_zero(self._stop)

    def enqueue(self, given: StepInput, state: RunState) -> Enqueued:
        """Enqueue a step; anchors that are about to be replaced are not updated."""
        device, config, room = self._device, self._config, self.room
        parameters, step = state.parameters, given.step
        if self._sizes != (room, parameters.rows):
            self._sizes = room, parameters.rows
            device.release_unused()
        target, scene = self._target(given), self._rounding.scene_at(state, step)
        frame = rasterise(device, scene, target.view, self.options, room)
        totals = check_room(device, frame, self._stop)
        compared, d_image = self._compare(state, frame, target, given)
        weight = config.volume_weight or 0.0
        gradients = rasterise_backward(device, scene, frame, d_image, weight)
        bits = self._rate.add(state.rate, parameters, gradients, step)
        replaces = replaces_anchors(config, step)
        with device.stage("adam"):
            learn = not replaces and step <= config.freeze_step
            found = gradients, compared.sums.partials
            self._optimizer.step(parameters, *found, learn, step, self._stop, state.begun)
            if state.exposures is not None:
                self._exposure.learn(state.exposures, given.index, step, self._stop)
        with device.stage("density"):
            observe(device, config, parameters, frame, gradients, step, self._stop)
        enqueued = Enqueued(
            given=given,
            loss=compared.value_later(device),
            stop=device.download_later(self._stop),
            totals=device.download_later(totals),
            room=frame.room,
            rate_bits=bits,
            frame=frame if replaces else None,
        )
        device.flush()
        return enqueued

    def render(self, given: StepInput, state: RunState) -> Frame:
        """Render what a step compares with its photo; arrays have their exact sizes."""
        scene = self._rounding.scene_at(state, given.step)
        return rasterise(self._device, scene, self._target(given).view, self.options)

    def _target(self, given: StepInput) -> TrainingPhoto:
        """The view and the photo of a step."""
        factor = reduction(self._config, given.step)
        return self._photos.get(given.index, given.background, factor)

    def _compare(
        self, state: RunState, frame: Frame, target: TrainingPhoto, given: StepInput
    ) -> tuple[loss.Loss, DeviceArray]:
        """The loss and its gradient by the render."""
        device, config, photo, used = self._device, self._config, target.photo, target.used
        exposures, picture = state.exposures, frame.image
        if exposures is not None and not self._exposure.learn_at(given.step):
            exposures = None
        if exposures is not None:
            with device.stage("exposure"):
                picture = exposure.forward(device, picture, exposures.maps, given.index)
        with device.stage("loss forward"):
            picture = picture if used is None else mask.forward(device, picture, used)
            weights = loss.Weights(config.l1_weight, config.ssim_weight)
            compared = loss.forward(device, picture, photo, weights)
        with device.stage("loss backward"):
            gradient = loss.backward(device, picture, photo, compared)
            gradient = gradient if used is None else mask.backward(device, gradient, used)
        if exposures is not None:
            with device.stage("exposure"):
                given_photo = frame.image, gradient, given.index
                gradient = self._exposure.backward(exposures, *given_photo, self._stop)
        return compared, gradient
