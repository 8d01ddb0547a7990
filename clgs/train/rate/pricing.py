"""What is worth its bytes at a price per bit: which anchors, which digits, at which scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.codec.fit_size import anchor_bits
from clgs.scene.anchors import (
    AnchorSet,
    QuantizationScales,
    QuantizedAnchors,
    dequantize,
    take,
)
from clgs.train.density.voxel_grid import position_integers
from clgs.train.rate.cheaper_integers import best_scale, cheaper_integers
from clgs.train.rate.judgement import Judgement
from clgs.train.state.parameters import ANCHOR_GROUPS, HostRows

MOST = 0.2
"""The largest share of the anchors that goes in one round."""

COARSE = 2.0
"""Scales are chosen at this many times the price: training then moves values to where rounding
hurts less, for which a finer scale would spend bytes.
"""

LEAST_PRICE, MOST_PRICE = 1e-15, 1e-3
"""The price of a bit is searched between these."""

PRICE_STEPS = 16

SMALL_PRICE = 1e-13
"""If a size leaves less than this price, it may hold everything, which is then tried. It is not
tried at once, because each trial encodes a file.
"""

CHEAPER = 0.5
"""The next price that is tried is this many times the one before."""

Measure = Callable[[QuantizedAnchors, QuantizationScales], int]
"""A function that returns the bytes of the file of some anchors."""


@dataclass(frozen=True)
class Situation:
    """Anchors before a round, what changes of them cost, and the scales so far.

    free: names of the attributes whose scale may still be chosen.
    """

    anchors: AnchorSet
    judged: Judgement
    scales: QuantizationScales
    free: frozenset[str] = frozenset()


@dataclass(frozen=True)
class PricedAnchors:
    """What a price per bit leaves: integers of all anchors, their scales, worth per bit (A,)."""

    price: float
    integers: QuantizedAnchors
    scales: QuantizationScales
    worth: npt.NDArray[np.float64]

    @property
    def kept(self) -> QuantizedAnchors:
        """The anchors that are worth their bytes."""
        return take(self.integers, self.worth >= self.price)

    def stay(self, most: float) -> npt.NDArray[np.bool_]:
        """Which anchors (A,) stay if at most the share ``most`` of them goes."""
        if most <= 0:
            return np.ones(len(self.worth), np.bool_)
        limit = float(np.quantile(self.worth, most, method="lower"))
        return self.worth >= min(self.price, limit)

    def outcome(self, most: float) -> AnchorSet:
        """The anchors that :meth:`apply` leaves, rounded."""
        return dequantize(take(self.integers, self.stay(most)), self.scales)

    def apply(self, rows: HostRows, most: float) -> tuple[int, npt.NDArray[np.bool_]]:
        """Give ``rows`` these integers and drop at most the share ``most`` of them.

        Values that change lose their momentum. Returns how many integers changed, and which anchors
        (A,) stay.

        Raises:
            ClgsError: no anchor is left.
        """
        changed = 0
        for name, moments in rows.moments.items():
            values = getattr(rows.anchors, name)
            q, best = getattr(self.scales, name), getattr(self.integers, name)
            moved = best != np.rint(values * np.float32(q))
            values[moved] = (best[moved] / q).astype(np.float32)
            moments.first[moved] = 0.0
            changed += int(moved.sum())
        kept = self.stay(most)
        rows.keep(kept)
        return changed, kept


def priced(price: float, now: Situation) -> PricedAnchors:
    """What ``price``, in units of the loss, leaves; ``now`` is not changed."""
    integers, scales, anchors = {}, now.scales, now.anchors
    for name in ANCHOR_GROUPS:
        values, curvature = getattr(anchors, name), now.judged.curvature(name)
        if name in now.free:
            scales = replace(scales, **{name: best_scale(values, curvature, COARSE * price)})
        cheap = cheaper_integers(values, curvature, getattr(scales, name), price)
        integers[name] = cheap.astype(np.int32)
    cells = position_integers(anchors.position, scales.position).astype(np.int32)
    quantized = QuantizedAnchors(position=cells, **integers)
    return PricedAnchors(price, quantized, scales, now.judged.importance / anchor_bits(quantized))


def priced_within_loss(
    most: float, price: float, now: Situation, loss: Callable[[PricedAnchors], float]
) -> PricedAnchors:
    """What ``price`` leaves, or a lower one, so that ``loss`` is at most ``most`` times the least.

    The least loss is that of the finest integers.
    """
    limit = most * loss(priced(LEAST_PRICE, now))
    while loss(found := priced(price, now)) > limit and price > LEAST_PRICE:
        price *= CHEAPER
    return found


def priced_for_size(size: int, now: Situation, measure: Measure) -> PricedAnchors:
    """What the lowest price leaves whose file has at most ``size`` bytes."""
    low, high = np.log(LEAST_PRICE), np.log(MOST_PRICE)
    best, small = priced(MOST_PRICE, now), SMALL_PRICE
    for _ in range(PRICE_STEPS):
        middle = (low + high) / 2
        trial = priced(float(np.exp(middle)), now)
        if measure(trial.kept, trial.scales) > size:
            low = middle
            continue
        best, high = trial, middle
        if trial.price < small:
            finest, small = priced(LEAST_PRICE, now), 0.0
            if measure(finest.kept, finest.scales) <= size:
                return finest
    return best
