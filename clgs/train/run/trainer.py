"""The training step: render, compare, go back, grow and prune, update. Prints nothing."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from clgs.codec.scene_encoder import sort_anchors
from clgs.data.dataset import Dataset
from clgs.data.view import View
from clgs.errors import BudgetError, ClgsError
from clgs.opencl.device import Device
from clgs.options import RenderOptions
from clgs.render.budget import check_budget
from clgs.render.frame import EXACT_ROOM, Frame
from clgs.render.renderer import Renderer
from clgs.scene.anchors import quantize
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings
from clgs.train.config import TrainConfig
from clgs.train.config.run_settings import LEAST_ANCHORS
from clgs.train.config.settings import BLENDER
from clgs.train.density.densifier import Densifier
from clgs.train.density.initial_anchors import initial_anchors
from clgs.train.quality.score_views import mean_psnr
from clgs.train.rate.economy import Economy, Round
from clgs.train.run.start_mlps import start_mlps
from clgs.train.state.parameters import Parameters, new_parameters
from clgs.train.step.queue import Enqueued, Plan, StepQueue
from clgs.train.step.schedule import ViewSampler
from clgs.train.step.targets import BACKGROUNDS

PHOTOS_AHEAD = 2
"""Steps whose photos are read while the step before them is under way."""

UNDRAWN_STEPS = 10
"""Warn after this many steps at the start of a run that draw nothing."""

_log = logging.getLogger(__name__)


class NonFiniteLossError(ClgsError):
    """The loss or a gradient is not a number; names the step and the view."""


@dataclass(frozen=True)
class StepResult:
    """What one step reports: loss value, its parts, the view trained on, anchors afterwards.

    ``rate_bits`` is bits per anchor if the rate proxy ran, else None.
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

    def __init__(
        self, device: Device, dataset: Dataset, config: TrainConfig, ahead: bool = True
    ) -> None:
        """Start from the dataset's points.

        Args:
            device: where to train.
            dataset: views and points in scene units.
            config: resolved for the dataset and scaled to its number of steps.
            ahead: whether :meth:`steps` enqueues a step while the one before is under way; the
                results have the same bits either way.
        """
        self.device, self.dataset, self.config = device, dataset, config
        self.rng = np.random.default_rng(config.seed)
        most = _most_at_start(dataset, config)
        anchors = initial_anchors(dataset.points, config.voxel, most, config.seed)
        self.parameters: Parameters = new_parameters(
            device, anchors, start_mlps(config.start_mlps, self.rng)
        )
        self.queue = StepQueue(device, dataset, config)
        self.densifier = Densifier(device, config, self.parameters.count)
        self.sampler = ViewSampler(len(dataset.train), config.seed)
        self.steps_done = 0
        self.merged = 0
        self.economy = Economy(device, dataset, config)
        self.rounds: list[Round] = []
        self._ahead = ahead
        self._under_way: list[Enqueued] = []
        self._undrawn: int | None = 0

    @property
    def settings(self) -> RenderSettings:
        """How finished renders are made: a random background ends up black."""
        background = BACKGROUNDS.get(self.config.background, BACKGROUNDS["black"])
        return RenderSettings(background=background, near=self.config.near)

    @property
    def options(self) -> RenderOptions:
        """Accuracy and skips of every render."""
        return self.queue.options

    def step(self) -> StepResult:
        """Train on one view and wait for it.

        Raises:
            NonFiniteLossError: loss or gradient are not finite; the parameters are untouched.
        """
        return next(self.steps(1))

    def steps(self, count: int, stop: Callable[[], bool] = lambda: False) -> Iterator[StepResult]:
        """Train on ``count`` views, or fewer: no step is begun once ``stop()`` is true.

        When the iterator ends, all that began is done; in between, the device may be a step ahead
        of the results.

        Raises:
            NonFiniteLossError: as for :meth:`step`; later steps left no trace.
        """
        last = self.steps_done + count
        while True:
            begun = self.steps_done + len(self._under_way)
            if begun == last or stop():
                break
            while self._under_way and self._must_settle(begun + 1):
                yield self._settle()
            self._begin(begun + 1)
            while len(self._under_way) > int(self._ahead):
                yield self._settle()
        while self._under_way:
            yield self._settle()

    def _must_settle(self, step: int) -> bool:
        """Whether step number ``step`` begins with other anchors than the one before."""
        return (
            step == self.config.switch_step + 1
            or step - 1 in self.economy.steps
            or self.densifier.replaces_anchors(step - 1)
        )

    def _begin(self, step: int) -> None:
        if step == self.config.switch_step + 1 or step - 1 in self.economy.steps:
            self.compact()
        if step == self.config.switch_step + 1:
            self._align_positions()
        if step - 1 in self.economy.steps:
            self._round(step - 1)
        plan = Plan(step, self.sampler.next(), self.queue.color(self.rng))
        try:
            self._under_way.append(self.queue.enqueue(plan, self.parameters, self.densifier))
            self.queue.prepare(self.sampler.upcoming(PHOTOS_AHEAD), step + 1)
        except BudgetError as error:
            name = self.dataset.train[plan.index].name
            raise BudgetError(f"step {step}, view {name}: {error}", error.needed) from error

    def _round(self, step: int) -> None:
        """Leave out what is not worth its bytes after ``step``."""
        try:
            self.parameters, done = self.economy.round(
                self.parameters, self.queue, self.densifier, self.settings, step
            )
        except BudgetError as error:
            raise BudgetError(f"after step {step}: {error}", error.needed) from error
        self.rounds.append(done)

    def _settle(self) -> StepResult:
        """Wait for the oldest step under way; repeat it if it lacked room."""
        while not self._under_way[0].done:
            if not self._under_way[0].lacked_room():
                self._give_up()
            self._repeat()
        settled = self._under_way.pop(0)
        self._warn_if_undrawn(settled)
        if settled.frame is not None:
            self.parameters = self.densifier.replace_anchors(
                self.parameters, settled.frame, self.rng
            )
        if self._ahead and self.queue.room == EXACT_ROOM:
            self.queue.room = EXACT_ROOM.grown(settled.needed())
        self.steps_done, value = settled.plan.step, settled.loss.get()
        return StepResult(
            self.steps_done,
            self.dataset.train[settled.plan.index].name,
            value.value,
            value.l1,
            value.ssim,
            settled.rate_bits,
            self.parameters.count,
        )

    def _warn_if_undrawn(self, settled: Enqueued) -> None:
        """Say once if no step so far drew anything: nothing is learned then."""
        if self._undrawn is None:
            return
        self._undrawn = None if settled.needed().entries else self._undrawn + 1
        if self._undrawn and (
            self._undrawn == UNDRAWN_STEPS or settled.plan.step == self.config.steps
        ):
            _log.warning(
                "nothing was drawn in the first %d steps, so nothing was learned; try a smaller "
                "--smallest-anchor, or check the poses",
                self._undrawn,
            )
            self._undrawn = None

    def _repeat(self) -> None:
        """Do the steps under way again, in order, with more room for the first of them."""
        failed = self._under_way
        self.queue.room = failed[0].room.grown(failed[0].needed())
        self.queue.clear()
        self._under_way = [
            self.queue.enqueue(one.plan, self.parameters, self.densifier) for one in failed
        ]

    def _give_up(self) -> NoReturn:
        """Drop the steps under way, which changed nothing, and say why."""
        failed = self._under_way[0]
        self._under_way = []
        self.queue.clear()
        value = failed.loss.get().value
        what = "a gradient is not finite" if np.isfinite(value) else f"the loss is {value}"
        name = self.dataset.train[failed.plan.index].name
        raise NonFiniteLossError(
            f"{what} at step {failed.plan.step}, view {name}; parameters untouched"
        )

    def compact(self) -> None:
        """Leave out the rows of anchors that were pruned; no result depends on it."""
        assert not self._under_way, "their frames count by the rows that there were"
        self.parameters = self.densifier.compacted(self.parameters)

    def _align_positions(self) -> None:
        """At the switch step, if Q_P is not that of the voxels: one anchor per cell of 1/Q_P."""
        if abs(self.config.position_q * self.config.voxel - 1.0) > 1e-9:
            q_position = self.config.position_q
            self.parameters, self.merged = self.densifier.align(self.parameters, q_position)

    def estimated_bits(self) -> float:
        """Bits per anchor of the rounded attributes, about as the file will have them."""
        return self.queue.estimated_bits(self.parameters)

    def render_next(self) -> Frame:
        """What the next step would compare if it saw the first view on black."""
        plan = Plan(self.steps_done + 1, 0, BACKGROUNDS["black"])
        return self.queue.render(plan, self.parameters)

    def check_budget(self) -> None:
        """Refuse a memory budget that the present anchors already exceed in some view of the data.

        Raises:
            BudgetError: names the view that needs most, and the least budget for all of them.
        """
        views = [(view.name, view.camera) for view in self.dataset.train + self.dataset.test]
        scene = self.queue.seen(self.parameters, self.steps_done)
        check_budget(self.device, scene, views, self.settings, self.options)

    def psnr(self, views: list[View]) -> float:
        """Mean 8-bit PSNR of the current parameters on ``views``."""
        scene = self.queue.seen(self.parameters, self.steps_done)
        settings = self.settings
        renderer = Renderer.of_device_scene(self.device, scene, settings, self.options)
        return mean_psnr(renderer, views, settings.background)

    def quantized_scene(self) -> QuantizedScene:
        """The trained scene as integers, in Morton order: what is encoded and rendered."""
        anchors = self.parameters.download_anchors(self.device)
        return QuantizedScene(
            sort_anchors(quantize(anchors, self.queue.scales)),
            Mlps(self.device.download(self.queue.final_weights(self.parameters))),
            self.queue.scales,
            self.settings,
            self.dataset.transform,
        )


def _most_at_start(dataset: Dataset, config: TrainConfig) -> int:
    """Anchors to start from at most; 0: as many as there are voxels with points."""
    limits = [config.most_anchors] if config.most_anchors else []
    if config.start_pixels and dataset.kind != BLENDER:
        pixels = max(view.camera.width * view.camera.height for view in dataset.train)
        limits.append(max(LEAST_ANCHORS, int(pixels / config.start_pixels)))
    return min(limits, default=0)
