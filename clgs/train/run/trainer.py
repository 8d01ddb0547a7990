"""A run of training steps, with growing, pruning and rounds in between. Prints nothing."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from clgs.codec.scene_encoder import sort_anchors
from clgs.data.dataset import Dataset
from clgs.data.view import View
from clgs.errors import BudgetError, ClgsError, UsageError
from clgs.opencl.device import Device
from clgs.ops import scan
from clgs.options import BACKGROUNDS
from clgs.render.frame import EXACT_ROOM, Frame
from clgs.render.renderer import Renderer
from clgs.scene.anchors import quantize
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene
from clgs.train.config import TrainConfig
from clgs.train.quality.scores import mean_psnr
from clgs.train.rate.economy import Economy, Round
from clgs.train.run.load import first_state
from clgs.train.state.checkpoint import changed_settings, load_state, save_state
from clgs.train.state.hashes import run_digest
from clgs.train.state.rounding import Rounding
from clgs.train.state.run_state import Means, Parameters, RunState, render_settings
from clgs.train.step import optimizer
from clgs.train.step.grow_and_prune import (
    compacted,
    merge_cells,
    replace_anchors,
    replaces_anchors,
)
from clgs.train.step.look import ViewInput
from clgs.train.step.queue import Enqueued, StepInput, StepQueue

PHOTOS_AHEAD = 2
"""The number of steps whose photos are read while the step before them is under way."""

UNDRAWN_STEPS = 10
"""Warn after this many steps at the start of a run that draw nothing."""

_log = logging.getLogger(__name__)


class NonFiniteLossError(ClgsError):
    """The loss or a gradient is not a number; names the step and the view."""


@dataclass(frozen=True)
class StepResult:
    """What one step reports: loss value, its parts, the view trained on, anchors afterwards.

    Of a batch, the loss is the mean, and ``view`` names all views, with commas between.
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
    """Runs the steps and rounds of one run; all that they change is in ``state``."""

    def __init__(
        self,
        device: Device,
        dataset: Dataset,
        config: TrainConfig,
        ahead: bool = True,
        state: RunState | None = None,
        others: Sequence[Device] = (),
    ) -> None:
        """Start from the dataset's points, or continue from ``state``.

        Args:
            device: where to train.
            dataset: views and points in scene units.
            config: resolved for the dataset and scaled to its number of steps.
            ahead: whether :meth:`steps` enqueues a step while the one before is under way; the
                results have the same bits either way.
            state: of a run on this data set, or of a trained scene, see
                :func:`clgs.train.run.load.state_of_scene`.
            others: further devices, of the kind of ``device``, that look at views of a batch. The
                results have the same bits with any of them or none.

        Raises:
            UsageError: a batch has more views than there are training photos.
        """
        if config.batch > len(dataset.train):
            raise UsageError(
                f"batch: {config.batch} views per step, but there are {len(dataset.train)} "
                "training photos; give fewer devices, or a smaller batch"
            )
        self.device, self.dataset, self.config = device, dataset, config
        self.state = state or first_state(device, dataset, config)
        self.settings = render_settings(config, dataset.train)
        self.options = config.render_options()
        self.rounding = Rounding(device, config)
        self.queue = StepQueue(device, dataset, config, self.rounding, others)
        self.economy = Economy(device, dataset, config, self.rounding)
        self.rounds: list[Round] = []
        self._ahead = ahead
        self._under_way: list[Enqueued] = []
        self._undrawn: int | None = 0

    @property
    def parameters(self) -> Parameters:
        """The trained parameters."""
        return self.state.parameters

    @property
    def steps_done(self) -> int:
        """The number of the last step done."""
        return self.state.step

    @property
    def heeds_lambda(self) -> bool:
        """Whether bits have the price that lambda asks for, or a round to come sets it."""
        state, config = self.state, self.config
        wanted = config.size_lambda and not config.target_size and not state.rate.price
        return not wanted or any(step >= state.step for step in self.economy.steps)

    def save(self, folder: Path) -> None:
        """Write a checkpoint of the last step done into ``folder``; no step may be under way.

        Raises:
            ClgsError: as :func:`clgs.train.state.checkpoint.save`.
        """
        self.compact()
        self.device.release_unused()
        save_state(folder, self.device, self.state, run_digest(self.dataset, self.config))

    def resume(self, folder: Path) -> None:
        """Continue from the newest usable checkpoint in ``folder``.

        Raises:
            DataError: as :func:`clgs.train.state.checkpoint.load_state`.
        """
        changed = changed_settings(folder.parent, self.config)
        digest = run_digest(self.dataset, self.config)
        self.state = load_state(folder, self.device, digest, changed)

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
            while len(self._under_way) > int(self._ahead and not self.queue.waits):
                yield self._settle()
        while self._under_way:
            yield self._settle()

    def _must_settle(self, step: int) -> bool:
        """Whether step number ``step`` begins with other anchors than the one before."""
        return (
            step - 1 in (self.config.switch_step, self.config.freeze_step)
            or step - 1 in self.economy.steps
            or replaces_anchors(self.config, step - 1)
        )

    def _begin(self, step: int) -> None:
        state, config = self.state, self.config
        if step == config.switch_step + 1 or step - 1 in self.economy.steps:
            self.compact()
        if step == config.switch_step + 1:
            self.align_positions()
        if step - 1 == config.freeze_step:
            optimizer.take(state, step - 1)
        if step - 1 in self.economy.steps:
            try:
                self.rounds.append(self.economy.round(state, step - 1))
            except BudgetError as error:
                raise BudgetError(f"after step {step - 1}: {error}", error.needed) from error
            state.means = Means(step - 1)
        given = self.queue.next_input(state, step)
        try:
            self._under_way.append(self.queue.enqueue(given, state))
            self.queue.prepare(state.views.upcoming(PHOTOS_AHEAD * config.batch), step + 1)
        except BudgetError as error:
            names = self._names(given)
            raise BudgetError(f"step {step}, view {names}: {error}", error.needed) from error

    def _settle(self) -> StepResult:
        """Wait for the oldest step under way; repeat it if it lacked room."""
        while stop := self._under_way[0].stop:
            if not stop & scan.LACKS_ROOM:
                self._give_up()
            failed = self._under_way  # again, in order, with more room for the first of them
            self.queue.room = failed[0].room.grown(failed[0].needed())
            self.queue.clear()
            self._under_way = [self.queue.enqueue(one.given, self.state) for one in failed]
        settled = self._under_way.pop(0)
        self._warn_if_undrawn(settled)
        state = self.state
        if settled.frame is not None:
            state.parameters = replace_anchors(
                self.device, self.config, state.parameters, settled.frame, state.rng
            )
            self.device.release_unused()  # arrays of these sizes come again with the next ones
        if self._ahead and self.queue.room == EXACT_ROOM:
            self.queue.room = EXACT_ROOM.grown(settled.needed())
        state.step, value = settled.given.step, settled.loss()
        if state.step == self.config.steps:
            optimizer.take(state, state.step)
        return StepResult(
            state.step,
            self._names(settled.given),
            value.value,
            value.l1,
            value.ssim,
            settled.rate_bits,
            state.parameters.count,
        )

    def _warn_if_undrawn(self, settled: Enqueued) -> None:
        """Say once if no step so far drew anything: nothing is learned then."""
        if self._undrawn is None:
            return
        self._undrawn = None if settled.needed().entries else self._undrawn + 1
        if self._undrawn and (
            self._undrawn == UNDRAWN_STEPS or settled.given.step == self.config.steps
        ):
            _log.warning(
                "nothing was drawn in the first %d steps, so nothing was learned; try a smaller "
                "--smallest-anchor, or check the poses",
                self._undrawn,
            )
            self._undrawn = None

    def _give_up(self) -> NoReturn:
        """Drop the steps under way, which changed nothing, and say why."""
        failed = self._under_way[0]
        self._under_way = []
        self.queue.clear()
        value = failed.loss().value
        what = "a gradient is not finite" if np.isfinite(value) else f"the loss is {value}"
        raise NonFiniteLossError(
            f"{what} at step {failed.given.step}, view {self._names(failed.given)}; "
            "parameters untouched"
        )

    def _names(self, given: StepInput) -> str:
        """The names of the views of a step."""
        return ", ".join(self.dataset.train[view.index].name for view in given.views)

    def compact(self) -> None:
        """Leave out the rows of anchors that were pruned; no result depends on it."""
        assert not self._under_way, "their frames count by the rows that there were"
        self.state.parameters = compacted(self.device, self.state.parameters)

    def align_positions(self) -> None:
        """Merge the anchors of each cell of 1/Q_P at the switch step, if voxels have another size.

        No anchor may be hidden.
        """
        state, config = self.state, self.config
        if abs(config.position_q * config.voxel - 1.0) > 1e-9:
            rows = state.parameters.download(self.device)
            state.merged = merge_cells(rows, config.position_q)
            state.parameters = state.parameters.with_rows(self.device, rows)

    def render_next(self) -> Frame:
        """What the next step would compare if it saw the first view on black."""
        return self.queue.render(
            self.state.step + 1, ViewInput(0, BACKGROUNDS["black"]), self.state
        )

    def check_budget(self) -> None:
        """Refuse a memory budget that the present anchors already exceed in some view of the data.

        Raises:
            BudgetError: names the view that needs most, and the least budget for all of them.
        """
        views = [(view.name, view.camera) for view in self.dataset.train + self.dataset.test]
        scene = self.rounding.scene_at(self.state, self.state.step)
        renderer = Renderer.of_device_scene(self.device, scene, self.settings, self.options)
        renderer.check_budget(views)

    def psnr(self, views: list[View]) -> float:
        """Mean 8-bit PSNR of the current parameters on ``views``."""
        scene = self.rounding.scene_at(self.state, self.state.step)
        settings = self.settings
        renderer = Renderer.of_device_scene(self.device, scene, settings, self.options)
        return mean_psnr(renderer, views, settings.background)

    def quantized_scene(self) -> QuantizedScene:
        """The trained scene as integers, in Morton order: what is encoded and rendered."""
        scales = self.state.rate.scales
        anchors = self.state.parameters.download_anchors(self.device)
        return QuantizedScene(
            sort_anchors(quantize(anchors, scales)),
            Mlps(self.device.download(self.rounding.final_weights(self.state))),
            scales,
            self.settings,
            self.dataset.transform,
        )
