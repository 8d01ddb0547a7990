"""Rounds in which anchors, and digits of anchors, go that are not worth their bytes.

While anchors still grow, those go that do not earn the bytes of a mean anchor: growth adds more
than is needed, and each costs time.

At the switch to integers the first round sets the price of a bit, and how many integers there are
per unit of each attribute. In every round integers become cheaper ones if the loss hardly changes,
and up to ``prune_end`` anchors go. Anchors gain importance as others go: at most a share of them
goes in one round, and training repairs the pictures in between. After the last round anchors rest.

The first round looks at the anchors from all the views that it asks. Later ones ask half of them by
turns, and mix what they find with what is known; those that let no anchor go only remember.

If a size of the file is asked for, every round looks for the price that would leave that size at
once, and the last one sees to it that it is met.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.data.dataset import Dataset
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import loss
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings
from clgs.train.config import TrainConfig
from clgs.train.config.settings import default_lambda
from clgs.train.config.size_settings import ANCHOR_BITS
from clgs.train.density.densifier import Densifier
from clgs.train.density.host_state import TrainState, keep_rows
from clgs.train.quality.importance import Sensitivity
from clgs.train.quality.rate_control import spread
from clgs.train.rate.judgement import Judge, Judgement
from clgs.train.rate.plan import (
    MOST,
    Measure,
    Plan,
    Situation,
    carry_out,
    outcome,
    plan_at,
    plan_for_size,
    plan_within,
)
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters
from clgs.train.step.queue import StepQueue

ROUNDS = 10

LEAST_ROUNDS = 3

ROUND_STEPS = 80
"""Steps between rounds at least, if there are more than LEAST_ROUNDS: with half of them, rounds
take a quarter of a short run.
"""

SIZED_ROUND_STEPS = 40
"""The same if a size is asked for, which is met the better the more rounds there are."""

UNLEARNED = 40
"""Before so many steps nothing has grown or learned yet."""

THINNED = (0.5, 0.7, 0.9)
"""Shares of the steps before the switch after which anchors go."""

MOST_THINNED = 0.3
"""Share of the anchors that goes at most each time: they gain importance as others go."""

VIEWS = 48
"""At most this many views say what is useful."""

MOST_LOSS = 1.35
"""Times the loss of the finest integers, the loss after the first round at most; to a power if
lambda is more than the default. What a price costs is estimated from small changes of single
values, and pictures that fit badly seem to allow large changes of many.
"""

NO_LIMIT = 1000.0
"""Times the usual lambda from which on the loss may grow as it will; the power stays finite."""

SPARE = 0.995
"""Share of the size asked for that is aimed at: the MLPs still change."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Round:
    """What a round did: anchors before and after, integers changed, and the price of a bit."""

    step: int
    before: int
    after: int
    changed: int
    price: float


@dataclass(frozen=True)
class Trials:
    """What is tried of a plan: the bytes of its file, and the loss of its pictures."""

    size: Measure
    loss: Callable[[Plan], float]


class Economy:
    """The rounds of one run."""

    def __init__(self, device: Device, dataset: Dataset, config: TrainConfig) -> None:
        """As for :class:`clgs.train.run.trainer.Trainer`."""
        self._device, self._dataset, self._config = device, dataset, config
        last = min(config.freeze_step, config.steps - 1)
        last = max(config.switch_step, last)
        apart = SIZED_ROUND_STEPS if config.target_size else ROUND_STEPS
        rounds = (last - config.switch_step) // apart
        rounds = min(max(rounds, LEAST_ROUNDS), ROUNDS)
        moments = np.linspace(config.switch_step, last, rounds)
        self._lambda = config.size_lambda or 0.0
        usual = default_lambda(dataset.kind, config.steps)
        self._most_loss = MOST_LOSS ** min(max(1.0, self._lambda / usual), NO_LIMIT)
        active = self._lambda > 0 or config.target_size > 0
        thinned = [share * config.switch_step for share in THINNED]
        if config.switch_step < UNLEARNED:
            thinned = []
        self.steps = sorted({round(each) for each in (*thinned, *moments)}) if active else []
        """The steps after which there is a round."""
        self._found: Sensitivity | None = None

    def round(
        self,
        parameters: Parameters,
        queue: StepQueue,
        densifier: Densifier,
        settings: RenderSettings,
        step: int,
    ) -> tuple[Parameters, Round]:
        """The round after ``step``: other parameters, and other scales and price in ``queue``.

        Raises:
            ClgsError: no anchor is left.
        """
        self._device.release_unused()
        judge = self._judge(settings, queue, step)
        scene = queue.seen(parameters, step + (step > self._config.switch_step))
        found = self._look(judge, scene, step)
        self._device.release_unused()  # what follows draws other sizes
        judged, drawn = judge.judge(scene, found), scene.weights
        mean_loss = judged.loss
        del scene
        self._device.release_unused()
        if step < self._config.switch_step:
            state = densifier.download(parameters)
            done = self._thin(state, judged, step)
        else:
            weights = Mlps(self._device.download(queue.final_weights(parameters)))
            trials = Trials(
                partial(self._size, weights=weights, settings=settings),
                partial(self._loss, judge, drawn),
            )
            anchors = parameters.scene.anchors.map(self._device.download)
            plan = self._plan(Situation(anchors, judged, queue.scales), queue, trials, step)
            del anchors, judged, trials, drawn  # before the moments come
            state = densifier.download(parameters)
            done, kept = self._carry_out(plan, state, queue, step)
            self._found = found.rows(kept)
        _log.info("%s, %s, loss %.5f", done, queue.scales, mean_loss)
        return densifier.replaced(parameters, state), done

    def _plan(self, now: Situation, queue: StepQueue, trials: Trials, step: int) -> Plan:
        """What is worth its bytes."""
        config = self._config
        if step == config.switch_step:
            now = replace(now, free=self._free())
            queue.rate.price = self._price(now.judged, len(now.anchors))
        if config.target_size:
            return plan_for_size(int(SPARE * config.target_size), now, trials.size)
        if step == config.switch_step:
            return plan_within(self._most_loss, queue.rate.price, now, trials.loss)
        return plan_at(queue.rate.price, now)

    def _carry_out(
        self, plan: Plan, state: TrainState, queue: StepQueue, step: int
    ) -> tuple[Round, npt.NDArray[np.bool_]]:
        """Change ``state`` to what is worth its bytes; which anchors (A,) are kept."""
        before = len(state.anchors)
        queue.rate.price, queue.rate.scales = plan.price, plan.scales
        changed, kept = carry_out(plan, state, self._most(step, step == self.steps[-1]))
        return Round(step, before, len(state.anchors), changed, plan.price), kept

    def _thin(self, state: TrainState, judged: Judgement, step: int) -> Round:
        """Leave out of ``state`` what does not earn the bytes of a mean anchor."""
        before = len(state.anchors)
        price = self._price(judged, before)
        keep_rows(state, self._earning(judged.importance / ANCHOR_BITS, price))
        return Round(step, before, len(state.anchors), 0, price)

    def _earning(self, worth: npt.NDArray[np.float64], price: float) -> npt.NDArray[np.bool_]:
        """Which anchors stay before the switch, by their worth per bit (A,)."""
        least = len(worth) - int(MOST_THINNED * len(worth))
        if self._config.target_size:
            least, price = max(least, self._config.held_anchors), math.inf
        if least >= len(worth):
            return np.ones(len(worth), np.bool_)
        limit = float(np.partition(worth, -least)[-least])
        return worth >= min(price, limit)

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """All that :meth:`restore` needs to continue exactly, by name."""
        if self._found is None:
            return {}
        known = {"importance": self._found.importance, "seen": self._found.seen}
        return {f"known.{name}": array for name, array in (known | self._found.curvature).items()}

    def restore(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Take what :meth:`state` gave; other arrays are ignored."""
        if "known.seen" in arrays:
            curvature = {name: arrays[f"known.{name}"] for name in ANCHOR_GROUPS}
            self._found = Sensitivity(arrays["known.importance"], curvature, arrays["known.seen"])

    def _look(self, judge: Judge, scene: DeviceScene, step: int) -> Sensitivity:
        """What is known of the anchors of ``scene`` in the round after ``step``."""
        known, turn = self._found, self.steps.index(step) % 2
        if step < self._config.switch_step:
            return judge.look(scene, turn, 2, curved=False)
        if known is None:
            return judge.look(scene)
        if step > self._config.prune_end:
            return known
        return known.mean(judge.look(scene, turn, 2))

    def _size(
        self,
        anchors: QuantizedAnchors,
        scales: QuantizationScales,
        weights: Mlps,
        settings: RenderSettings,
    ) -> int:
        """Bytes of the file of ``anchors``."""
        anchors, transform = sort_anchors(anchors), self._dataset.transform
        return len(encode(QuantizedScene(anchors, weights, scales, settings, transform)))

    def _loss(self, judge: Judge, weights: DeviceArray, plan: Plan) -> float:
        """Of the pictures, if ``plan`` were carried out."""
        anchors = outcome(plan, MOST).map(self._device.upload)
        return judge.compare(DeviceScene(anchors, weights))[0]

    def _judge(self, settings: RenderSettings, queue: StepQueue, step: int) -> Judge:
        views, config = self._dataset.train, self._config
        chosen = [views[i] for i in spread([view.camera for view in views], VIEWS)]
        weights = loss.Weights(config.l1_weight, config.ssim_weight)
        every = len(chosen) == len(views) and step >= config.switch_step
        return Judge(self._device, chosen, every, settings, queue.options, weights)

    def _free(self) -> frozenset[str]:
        names = ("offset", "feature", "scaling")
        return frozenset(name for name in names if getattr(self._config, f"{name}_q") == 0)

    def _price(self, judged: Judgement, anchors: int) -> float:
        """Of a bit: lambda is what halving the file may cost in dB, at this loss and size."""
        loss_per_decibel = judged.loss * math.log(10.0) / 20.0
        bits = ANCHOR_BITS * anchors * math.log(2.0)
        return self._lambda * loss_per_decibel / bits

    def _most(self, step: int, last: bool) -> float:
        """The share of the anchors that goes at most after ``step``."""
        if step <= self._config.prune_end:
            return MOST
        return 1.0 if last and self._config.target_size else 0.0
