"""One training step: all of its work is put in the device's queue, and waited for later."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clgs.data.dataset import Dataset
from clgs.data.stored_photo import Color
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import adam, loss, mask, quantize, scan
from clgs.render.frame import EXACT_ROOM, DeviceScene, Frame, Room
from clgs.render.pipeline import check_room, render_backward, view_forward
from clgs.scene.anchors import QuantizationScales
from clgs.train.config import TrainConfig
from clgs.train.config.settings import PAPER_Q
from clgs.train.density.densifier import Densifier
from clgs.train.rate.rate_term import RateTerm
from clgs.train.state.parameters import Parameters
from clgs.train.step.exposures import Exposures
from clgs.train.step.optimizer import Learned, Optimizer
from clgs.train.step.rounding import rounded_anchors, weight_scales
from clgs.train.step.schedule import reduction
from clgs.train.step.targets import Target, Targets


@dataclass(frozen=True)
class Plan:
    """All that it takes to do a step again: its number, view and background."""

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

    plan: Plan
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

    def __init__(self, device: Device, dataset: Dataset, config: TrainConfig) -> None:
        """As for :class:`clgs.train.run.trainer.Trainer`."""
        self._device, self._config = device, config
        self._optimizer = Optimizer(device, config, dataset.radius)
        self._targets = Targets(device, dataset.train, config.background, config.near)
        self.exposures = Exposures(device, config, len(dataset.train)) if config.exposure else None
        self._stop = adam.stop_flag(device)
        self.options = config.render_options()
        q = {name: getattr(config, name) or paper for name, paper in PAPER_Q.items()}
        scales = QuantizationScales(
            config.position_q, q["offset_q"], q["feature_q"], q["scaling_q"]
        )
        self.rate = RateTerm(device, config, scales)
        quantized = config.mlp == "quantized"
        self._weight_scales = device.upload(weight_scales()) if quantized else None
        self.room = EXACT_ROOM
        self._sizes = self.room, 0

    @property
    def scales(self) -> QuantizationScales:
        """The integers per unit that attributes are rounded to."""
        return self.rate.scales

    def color(self, rng: np.random.Generator) -> Color:
        """The background of the next step."""
        return self._targets.color(rng)

    def prepare(self, indices: list[int], step: int) -> None:
        """Have the photos of the steps from number ``step`` on read ahead of them."""
        self._targets.prepare(indices, reduction(self._config, step))

    def clear(self) -> None:
        """Let the steps enqueued from now on change the parameters again."""
        self._device.fill_zero(self._stop)

    def enqueue(self, plan: Plan, parameters: Parameters, densifier: Densifier) -> Enqueued:
        """Enqueue a step; anchors that are about to be replaced are not updated."""
        device, room = self._device, self.room
        if self._sizes != (room, parameters.rows):
            self._sizes = room, parameters.rows
            device.release_unused()
        target, scene = self._target(plan), self.seen(parameters, plan.step)
        frame = view_forward(device, scene, target.view, self.options, room)
        totals = check_room(device, frame, room, self._stop)
        compared, d_image = self._compare(frame, target, plan)
        weight = self._config.volume_weight or 0.0
        gradients = render_backward(device, scene, frame, d_image, weight)
        bits = self.rate.add(parameters, gradients, plan.step)
        replaces = densifier.replaces_anchors(plan.step)
        with device.stage("adam"):
            learn = not replaces and plan.step <= self._config.freeze_step
            learned = Learned(gradients, learn, compared.sums.partials)
            self._optimizer.step(parameters, learned, plan.step, self._stop)
            if self.exposures is not None:
                self.exposures.step(plan.index, plan.step, self._stop)
        with device.stage("density"):
            densifier.observe(frame, gradients, plan.step, self._stop)
        enqueued = Enqueued(
            plan=plan,
            loss=compared.value_later(device),
            stop=device.download_later(self._stop),
            totals=device.download_later(totals),
            room=room,
            rate_bits=bits,
            frame=frame if replaces else None,
        )
        device.flush()
        return enqueued

    def render(self, plan: Plan, parameters: Parameters) -> Frame:
        """What a step compares with its photo, made to measure."""
        scene = self.seen(parameters, plan.step)
        return view_forward(self._device, scene, self._target(plan).view, self.options)

    def _target(self, plan: Plan) -> Target:
        """The view and the photo of a step."""
        factor = reduction(self._config, plan.step)
        return self._targets.get(plan.index, plan.background, factor)

    def seen(self, parameters: Parameters, step: int) -> DeviceScene:
        """The parameters as step number ``step`` renders them: rounded after the switch steps."""
        scene = parameters.scene
        with self._device.stage("quantize"):
            if step > self._config.switch_step:
                anchors = rounded_anchors(self._device, scene.anchors, self.scales)
                scene = replace(scene, anchors=anchors)
            if step > self._config.mlp_switch_step:
                scene = replace(scene, weights=self.final_weights(parameters))
        return scene

    def final_weights(self, parameters: Parameters) -> DeviceArray:
        """The weights of the MLPs as they are stored: rounded, unless float32 is asked for."""
        if self._weight_scales is None:
            return parameters.scene.weights
        return quantize.elements(self._device, parameters.scene.weights, self._weight_scales)

    def _compare(self, frame: Frame, target: Target, plan: Plan) -> tuple[loss.Loss, DeviceArray]:
        """The loss and its gradient by the render."""
        exposures, index = self.exposures, plan.index
        if exposures is None or not exposures.learn_at(plan.step):
            return self._loss(frame.image, target)
        with self._device.stage("exposure"):
            picture = exposures.expose(frame.image, index)
        compared, d_picture = self._loss(picture, target)
        with self._device.stage("exposure"):
            return compared, exposures.backward(frame.image, d_picture, index, self._stop)

    def _loss(self, picture: DeviceArray, target: Target) -> tuple[loss.Loss, DeviceArray]:
        """The loss and its gradient by the picture."""
        device, photo, used = self._device, target.photo, target.used
        weights = loss.Weights(self._config.l1_weight, self._config.ssim_weight)
        with device.stage("loss forward"):
            picture = picture if used is None else mask.forward(device, picture, used)
            compared = loss.forward(device, picture, photo, weights)
        with device.stage("loss backward"):
            d_picture = loss.backward(device, picture, photo, compared)
            return compared, d_picture if used is None else mask.backward(device, d_picture, used)

    def estimated_bits(self, parameters: Parameters) -> float:
        """Bits per anchor of the rounded attributes, by the frequencies of each channel."""
        return self.rate.estimated_bits(parameters)
