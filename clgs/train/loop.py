"""The training step: render, compare, go back, grow and prune, update. Prints nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.codec.encode import sort_anchors
from clgs.data.dataset import Dataset, View
from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import loss, rate
from clgs.options import render_options
from clgs.render.frame import DeviceScene, Frame, SceneGradients
from clgs.render.pipeline import render_backward, view_forward
from clgs.render.renderer import render_picture
from clgs.scene.anchors import QuantizationScales
from clgs.scene.mlps import Mlps, init_mlps
from clgs.scene.scene import QuantizedScene, RenderSettings
from clgs.train.config import TrainConfig
from clgs.train.densify import Densifier
from clgs.train.evaluate import psnr_8bit, to_8bit
from clgs.train.initial import initial_anchors
from clgs.train.optimizer import Optimizer
from clgs.train.parameters import (
    ANCHOR_GROUPS,
    Parameters,
    download_anchors,
    new_parameters,
    quantized_anchors,
    quantized_view,
)
from clgs.train.schedule import ViewSampler, reduction
from clgs.train.targets import BACKGROUNDS, Targets, planar


class NonFiniteLossError(ClgsError):
    """The loss or a gradient is not a number; names the step and the view."""


@dataclass(frozen=True)
class StepResult:
    """What one step reports: loss value, its parts, the view trained on, anchors afterwards.

    ``rate_bits`` is bits per anchor where the rate proxy ran, else None.
    """

    step: int
    view: str
    loss: float
    l1: float
    ssim: float
    rate_bits: float | None
    anchors: int


class Trainer:
    """Holds the state of one run; :meth:`step` advances it by one view."""

    def __init__(self, device: Device, dataset: Dataset, config: TrainConfig) -> None:
        """Start from the dataset's points.

        Args:
            device: where to train.
            dataset: views and points in scene units.
            config: resolved for the dataset and scaled to its number of steps.
        """
        self.device, self.dataset, self.config = device, dataset, config
        self.rng = np.random.default_rng(config.seed)
        anchors = initial_anchors(dataset.points, config.voxel)
        self.parameters: Parameters = new_parameters(device, anchors, init_mlps(self.rng))
        self.scales = QuantizationScales(
            config.position_q, config.offset_q, config.feature_q, config.scaling_q
        )
        self.optimizer = Optimizer(device, config, dataset.radius)
        self.densifier = Densifier(device, config, self.parameters.count)
        self.sampler = ViewSampler(len(dataset.train), config.seed)
        self.targets = Targets(device, dataset.train, config.background, config.near)
        self.options = render_options(config.accuracy)
        self.steps_done = 0
        self.last_frame: Frame | None = None
        self.merged = 0

    @property
    def settings(self) -> RenderSettings:
        """How finished renders are made: a random background ends up black."""
        background = BACKGROUNDS.get(self.config.background, BACKGROUNDS["black"])
        return RenderSettings(background=background, near=self.config.near)

    @property
    def quantizing(self) -> bool:
        """Whether the next step renders rounded parameters."""
        return self.steps_done + 1 > self.config.switch_step

    def step(self) -> StepResult:
        """Train on one view.

        Raises:
            NonFiniteLossError: the loss is not finite; the parameters are untouched.
        """
        if self.steps_done == self.config.switch_step:
            self._align_positions()
        self.last_frame = None  # gives its memory back before the next one is made
        step = self.steps_done + 1
        index = self.sampler.next()
        view = self.dataset.train[index]
        background = self.targets.color(self.rng)
        target = self.targets.get(index, background, reduction(self.config, step))
        scene = self.parameters.scene
        if self.quantizing:
            with self.device.stage("quantize"):
                scene = quantized_view(self.device, scene, self.scales)
        frame = view_forward(self.device, scene, target.view, self.options)
        value, d_image = self._loss(frame, target.photo, step, view.name)
        gradients = render_backward(
            self.device, scene, frame, d_image, self.config.volume_weight or 0.0
        )
        bits = self._add_rate(gradients) if self._rate_is_due(step) else None
        with self.device.stage("density"):
            replaced = self.densifier.after_backward(
                self.parameters, frame, gradients, step, self.rng
            )
        with self.device.stage("adam"):
            self._update(gradients, step, view.name, replaced is not None)
        if replaced is not None:
            self.parameters = replaced
        self.steps_done, self.last_frame = step, frame
        return StepResult(
            step, view.name, value.value, value.l1, value.ssim, bits, self.parameters.count
        )

    def _align_positions(self) -> None:
        """At the switch step, where Q_P is not that of the voxels: one anchor a cell of 1/Q_P."""
        if abs(self.config.position_q * self.config.voxel - 1.0) > 1e-9:
            q_position = self.config.position_q
            self.parameters, self.merged = self.densifier.align(self.parameters, q_position)

    def _loss(
        self, frame: Frame, target: DeviceArray, step: int, name: str
    ) -> tuple[loss.LossValue, DeviceArray]:
        weights = loss.Weights(self.config.l1_weight, self.config.ssim_weight)
        with self.device.stage("loss forward"):
            compared = loss.forward(self.device, frame.image, target, weights)
            value = compared.value(self.device)
        if not np.isfinite(value.value):
            raise NonFiniteLossError(
                f"the loss is {value.value} at step {step}, view {name}; parameters untouched"
            )
        with self.device.stage("loss backward"):
            return value, loss.backward(self.device, frame.image, target, compared)

    def _rate_is_due(self, step: int) -> bool:
        return step > self.config.switch_step and step % self.config.rate_interval == 0

    def _add_rate(self, gradients: SceneGradients) -> float:
        """Add the rate proxy's gradient in place; returns bits per anchor."""
        total = 0.0
        with self.device.stage("rate"):
            for name in ANCHOR_GROUPS:
                x, d_x = getattr(self.parameters.scene, name), getattr(gradients, f"d_{name}")
                result = self._rate(name)
                rate.backward(self.device, result, x, self.config.rate_weight, d_x)
                total += result.bits
        return total

    def _rate(self, name: str) -> rate.Rate:
        x, q = getattr(self.parameters.scene, name), getattr(self.scales, name)
        return rate.forward(
            self.device, x, q, "pooled" if self.config.proxy == "pooled" else "channel"
        )

    def estimated_bits(self) -> float:
        """Bits per anchor of the rounded attributes under the proxy's model."""
        return sum(self._rate(name).bits for name in ANCHOR_GROUPS)

    def _update(
        self, gradients: SceneGradients, step: int, view: str, anchors_replaced: bool
    ) -> None:
        if not self.optimizer.step(self.parameters, gradients, step, not anchors_replaced):
            raise NonFiniteLossError(
                f"a gradient is not finite at step {step}, view {view}; parameters untouched"
            )

    def rounded(self) -> DeviceScene:
        """The parameters as the last step rendered them: rounded once quantisation is on."""
        scene = self.parameters.scene
        started = self.steps_done > self.config.switch_step
        return quantized_view(self.device, scene, self.scales) if started else scene

    def psnr(self, views: list[View]) -> float:
        """Mean 8-bit PSNR of the current parameters on ``views``."""
        scene, settings = self.rounded(), self.settings
        values = []
        for view in views:
            image = render_picture(self.device, scene, view.camera, settings, self.options)
            photo = planar(view, settings.background).transpose(1, 2, 0)
            values.append(psnr_8bit(to_8bit(image), photo))
        return float(np.mean(values))

    def quantized_scene(self) -> QuantizedScene:
        """The trained scene as integers, in Morton order: what is encoded and rendered."""
        anchors, _ = download_anchors(self.device, self.parameters)
        return QuantizedScene(
            sort_anchors(quantized_anchors(anchors, self.scales)),
            Mlps(self.device.download(self.parameters.scene.weights)),
            self.scales,
            self.settings,
            self.dataset.transform,
        )
