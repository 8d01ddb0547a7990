"""Rounds in which anchors, and digits of anchors, go that are not worth their bytes.

While anchors still grow, rounds remove those that do not earn the bytes of a mean anchor: growth
adds more than is needed, and each costs time. If only the anchors of a box learn, these are all
rounds that there are, and the others stay.

At the switch to integers the first round sets the price of a bit, and how many integers there are
per unit of each attribute. In every round integers become cheaper ones if the loss hardly changes,
and up to ``prune_end`` anchors go. Anchors gain importance as others go: at most a share of them
goes in one round, and training repairs the pictures in between and after the last one.

The first round looks at the anchors from all the views that it asks. Later ones ask alternate
halves of them, and mix what they find with what is known; those that let no anchor go only
remember.

If a size of the file is asked for, every round looks for the price that would leave that size at
once, and one more, after which anchors rest, makes sure that it is met.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.data.dataset import Dataset
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene
from clgs.train.config import TrainConfig
from clgs.train.config.settings import default_lambda
from clgs.train.config.size_settings import ANCHOR_BITS
from clgs.train.quality.importance import Sensitivity
from clgs.train.quality.rate_control import spread
from clgs.train.rate.pricing import (
    MOST,
    Judgement,
    PricedAnchors,
    Situation,
    compare,
    judge,
    least_worth,
    look,
    priced,
    priced_for_size,
    priced_within_loss,
)
from clgs.train.state.rounding import Rounding
from clgs.train.state.run_state import ANCHOR_GROUPS, RunState, render_settings

ROUNDS = 10

LEAST_ROUNDS = 3

ROUND_STEPS = 80
"""Steps between rounds at least, if there are more than LEAST_ROUNDS: with half of them, rounds
take a quarter of a short run.
"""

SIZED_ROUND_STEPS = 40
"""The same if a size is asked for: the more rounds there are, the better it is met."""

UNLEARNED = 40
"""Before this many steps nothing has grown or learned yet."""

THINNED = (0.5, 0.7, 0.9)
"""Shares of the steps before the switch after which anchors go. A scene that has grown before, as
the merged one of blocks, keeps them then, unless a size is asked for: the less must go at the
switch, the better.
"""

MOST_THINNED = 0.3
"""Share of the anchors that goes at most each time: they gain importance as others go."""

VIEWS = 48
"""The most views that say what is useful."""

MOST_LOSS = 1.35
"""The loss after the first round is at most this many times that of the finest integers; the factor
is raised to a power if lambda is more than the default. What a price costs is estimated from small
changes of single values, and pictures that fit badly seem to allow large changes of many.
"""

MOST_DEARER = 2.0
"""If lambda is more than the default, up to this many times as many anchors go in a round: few good
ones make better pictures than many whose integers are coarse.
"""

NO_LIMIT = 1000.0
"""The loss has no limit from this many times the usual lambda on; the power stays finite."""

SPARE = 0.995
"""The share of the requested size that rounds aim at: the MLPs still change."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Round:
    """What a round did: anchors before and after, integers changed, and the price of a bit."""

    step: int
    before: int
    after: int
    changed: int
    price: float


class Economy:
    """The rounds of one run."""

    def __init__(
        self, device: Device, dataset: Dataset, config: TrainConfig, rounding: Rounding
    ) -> None:
        """Decide when there are rounds; ``config`` is resolved for the dataset."""
        self._device, self._dataset, self._config = device, dataset, config
        self._settings = render_settings(config, dataset.train)
        self._rounding = rounding
        last = min(config.freeze_step, config.steps - 1)
        last = max(config.switch_step, last)
        apart = SIZED_ROUND_STEPS if config.target_size else ROUND_STEPS
        rounds = (last - config.switch_step) // apart
        rounds = min(max(rounds, LEAST_ROUNDS), ROUNDS)
        ends = config.target_size > 0  # the size must be met; else training repairs what rounds do
        moments = np.linspace(config.switch_step, last, rounds, endpoint=ends)
        self._lambda = config.size_lambda or 0.0
        usual = default_lambda(dataset.kind, config.steps * config.batch)
        dearer = max(1.0, self._lambda / usual)
        self._most_loss = MOST_LOSS ** min(dearer, NO_LIMIT)
        self._most = MOST * min(dearer, MOST_DEARER)
        active = self._lambda > 0 or config.target_size > 0
        thinned = [share * config.switch_step for share in THINNED]
        if config.switch_step < UNLEARNED:
            thinned = []
        if config.box:
            moments = moments[:0]
        self.steps = sorted({round(each) for each in (*thinned, *moments)}) if active else []
        """The steps after which there is a round."""
        self.views = spread(dataset.train, VIEWS)
        """The views that rounds look from."""

    def round(self, state: RunState, step: int) -> Round:
        """Change ``state`` to what is worth its bytes after ``step``; no anchor may be hidden.

        The anchors, the price and the scales change.

        Raises:
            ClgsError: no anchor is left.
        """
        device, config = self._device, self._config
        has_grown = state.begun >= config.growth_end > 0
        if has_grown and step < config.switch_step and not config.target_size:
            count = state.parameters.count
            return Round(step, count, count, changed=0, price=0.0)
        device.release_unused()
        scene = self._rounding.scene_at(state, step + (step > config.switch_step))
        found = self._look(state.known, scene, step)
        device.release_unused()  # what follows draws other sizes
        mean_loss, squared_error = compare(device, config, scene, self.views)
        others = len(self.views) < len(self._dataset.train) or step < config.switch_step
        judged, drawn = judge(found, mean_loss, squared_error, others), scene.weights
        del scene
        device.release_unused()
        if step < config.switch_step:
            price = self._price(judged, state.parameters.count)
            rows = state.parameters.download(device)
            before, changed = len(rows.anchors), 0
            rows.keep(self._earning(judged.importance / ANCHOR_BITS, price, rows.anchors.position))
        else:
            offer = self._offer(state, judged, drawn, step)
            del judged, drawn  # before the moments come
            price, state.rate.price, state.rate.scales = offer.price, offer.price, offer.scales
            rows = state.parameters.download(device)
            before = len(rows.anchors)
            most = self._most if step <= config.prune_end else 0.0
            if step > config.prune_end and step == self.steps[-1] and config.target_size:
                most = 1.0  # the size must be met
            changed, kept = offer.apply(rows, most)
            state.known = found.rows(kept)
        done = Round(step, before, len(rows.anchors), changed, price)
        _log.info("%s, %s, loss %.5f", done, state.rate.scales, mean_loss)
        state.parameters = state.parameters.with_rows(device, rows)
        return done

    def _look(self, known: Sensitivity | None, scene: DeviceScene, step: int) -> Sensitivity:
        """What is known of the anchors of ``scene`` in the round after ``step``."""
        config, views = self._config, self.views
        half = views[self.steps.index(step) % 2 :: 2] or views  # one view has no second half
        if step < config.switch_step:
            return look(self._device, config, scene, half, curved=False)
        if known is None:
            return look(self._device, config, scene, views)
        if step > config.prune_end:
            return known
        return known.mean(look(self._device, config, scene, half))

    def _offer(
        self, state: RunState, judged: Judgement, drawn: DeviceArray, step: int
    ) -> PricedAnchors:
        """What is worth its bytes; sets the price at the switch to integers.

        ``drawn``: the weights of the MLPs that pictures are drawn with.
        """
        device, config, settings = self._device, self._config, self._settings
        anchors = state.parameters.scene.anchors.map(device.download)
        now = Situation(anchors, judged, state.rate.scales)
        weights = Mlps(device.download(self._rounding.final_weights(state)))

        def size(anchors: QuantizedAnchors, scales: QuantizationScales) -> int:
            anchors, transform = sort_anchors(anchors), self._dataset.transform
            return len(encode(QuantizedScene(anchors, weights, scales, settings, transform)))

        def loss(offer: PricedAnchors) -> float:
            anchors = offer.outcome(self._most).map(device.upload)
            return compare(device, config, DeviceScene(anchors, drawn), self.views)[0]

        if step == config.switch_step:
            free = (name for name in ANCHOR_GROUPS if getattr(config, f"{name}_q") == 0)
            now = replace(now, free=frozenset(free))
        if step == config.switch_step or not state.rate.price:
            state.rate.price = self._price(judged, len(anchors))
        if config.target_size:
            return priced_for_size(int(SPARE * config.target_size), now, size)
        if step == config.switch_step:
            return priced_within_loss(self._most_loss, state.rate.price, now, loss)
        return priced(state.rate.price, now)

    def _earning(
        self,
        worth: npt.NDArray[np.float64],
        price: float,
        position: npt.NDArray[np.float32],
    ) -> npt.NDArray[np.bool_]:
        """Which anchors stay before the switch, by their worth per bit (A,).

        ``position``: theirs, (A, 3); those that do not learn stay.
        """
        kept, box = np.ones(len(worth), np.bool_), self._config.learning_box
        may_go = np.ones_like(kept) if box is None else box.holds(position)
        candidates = worth[may_go]
        count = int(MOST_THINNED * len(candidates))
        if self._config.target_size:
            others = len(worth) - len(candidates)
            count = min(count, len(candidates) - (self._config.held_anchors - others))
            price = math.inf
        kept[may_go] = ~least_worth(candidates, count, price)
        return kept

    def _price(self, judged: Judgement, anchors: int) -> float:
        """The price of a bit at this loss and size: lambda is what halving may cost in dB."""
        loss_per_decibel = judged.loss * math.log(10.0) / 20.0
        bits = ANCHOR_BITS * anchors * math.log(2.0)
        return self._lambda * loss_per_decibel / bits
