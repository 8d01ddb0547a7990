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
from clgs.train.density.cells import position_integers
from clgs.train.density.host_state import TrainState, keep_rows
from clgs.train.rate.cheaper_integers import best_scale, cheaper_integers
from clgs.train.rate.judgement import Judgement

MOST = 0.2
"""Share of the anchors that goes in one round."""

COARSE = 2.0
"""Times the price at which scales are chosen: training then moves values to where rounding hurts
less, which a finer scale would cost bytes for.
"""

LEAST_PRICE, MOST_PRICE = 1e-15, 1e-3
"""Of a bit, when a price is searched."""

PRICE_STEPS = 16

SMALL_PRICE = 1e-13
"""A size that leaves less may hold everything, which is then tried: each trial codes a file."""

CHEAPER = 0.5
"""Times the price is the next that is tried."""

Measure = Callable[[QuantizedAnchors, QuantizationScales], int]
"""Bytes of the file of some anchors."""


@dataclass(frozen=True)
class Situation:
    """What a plan is made of: anchors with what changes of them cost, and the scales so far.

    free: names of the attributes whose scale may still be chosen.
    """

    anchors: AnchorSet
    judged: Judgement
    scales: QuantizationScales
    free: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Plan:
    """What a price per bit leaves: integers of all anchors, their scales, worth per bit (A,)."""

    price: float
    integers: QuantizedAnchors
    scales: QuantizationScales
    worth: npt.NDArray[np.float64]

    @property
    def kept(self) -> QuantizedAnchors:
        """The anchors that are worth their bytes."""
        return take(self.integers, self.worth >= self.price)


def plan_at(price: float, now: Situation) -> Plan:
    """What ``price``, in units of the loss, leaves; ``now`` is not changed."""
    integers, scales, anchors = {}, now.scales, now.anchors
    for name, curvature in now.judged.curvature.items():
        values = getattr(anchors, name)
        if name in now.free:
            scales = replace(scales, **{name: best_scale(values, curvature, COARSE * price)})
        cheap = cheaper_integers(values, curvature, getattr(scales, name), price)
        integers[name] = cheap.astype(np.int32)
    cells = position_integers(anchors.position, scales.position).astype(np.int32)
    planned = QuantizedAnchors(position=cells, **integers)
    return Plan(price, planned, scales, now.judged.importance / anchor_bits(planned))


def plan_within(most: float, price: float, now: Situation, loss: Callable[[Plan], float]) -> Plan:
    """What ``price`` leaves, or a lower one, so that ``loss`` is at most ``most`` times the least.

    The least is that of the finest integers.
    """
    limit = most * loss(plan_at(LEAST_PRICE, now))
    while loss(plan := plan_at(price, now)) > limit and price > LEAST_PRICE:
        price *= CHEAPER
    return plan


def plan_for_size(size: int, now: Situation, measure: Measure) -> Plan:
    """What the least price leaves that leaves at most ``size`` bytes."""
    low, high = np.log(LEAST_PRICE), np.log(MOST_PRICE)
    best, small = plan_at(MOST_PRICE, now), SMALL_PRICE
    for _ in range(PRICE_STEPS):
        middle = (low + high) / 2
        trial = plan_at(float(np.exp(middle)), now)
        if measure(trial.kept, trial.scales) > size:
            low = middle
            continue
        best, high = trial, middle
        if trial.price < small:
            finest, small = plan_at(LEAST_PRICE, now), 0.0
            if measure(finest.kept, finest.scales) <= size:
                return finest
    return best


def carry_out(plan: Plan, state: TrainState, most: float) -> tuple[int, npt.NDArray[np.bool_]]:
    """Change ``state`` to what ``plan`` leaves of it.

    ``most``: the share of the anchors that goes at most. What changes loses its momentum. Returns
    how many integers changed, and which anchors (A,) are kept.

    Raises:
        ClgsError: no anchor is left.
    """
    changed = 0
    for name, moments in state.moments.items():
        values = getattr(state.anchors, name)
        q, best = getattr(plan.scales, name), getattr(plan.integers, name)
        moved = best != np.rint(values * np.float32(q))
        values[moved] = (best[moved] / q).astype(np.float32)
        moments.first[moved] = 0.0
        changed += int(moved.sum())
    kept = _kept(plan, most)
    keep_rows(state, kept)
    return changed, kept


def outcome(plan: Plan, most: float) -> AnchorSet:
    """The anchors that :func:`carry_out` leaves, rounded."""
    return dequantize(take(plan.integers, _kept(plan, most)), plan.scales)


def _kept(plan: Plan, most: float) -> npt.NDArray[np.bool_]:
    """Which anchors (A,) stay if a share of ``most`` goes at most."""
    if most <= 0:
        return np.ones(len(plan.worth), np.bool_)
    limit = float(np.quantile(plan.worth, most, method="lower"))
    return plan.worth >= min(plan.price, limit)
