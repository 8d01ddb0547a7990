"""What is worth its bytes at a price per bit: which anchors, which digits, at which scales.

The loss is proportional to the root of the squared error E of the pictures, so that a change that
adds e to E adds e / (2 E) of the loss. ``clgs.train.quality.importance`` estimates e.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.codec.smaller import anchor_bits
from clgs.data.view import View
from clgs.opencl.device import Device
from clgs.ops import loss, mask, rate
from clgs.render.frame import EXACT_ROOM, DeviceScene, upload_view
from clgs.render.rasterise import rasterise, with_enough_room
from clgs.scene.anchors import (
    AnchorSet,
    QuantizationScales,
    QuantizedAnchors,
    dequantize,
    take,
)
from clgs.train.config import TrainConfig
from clgs.train.quality.importance import Sensitivity, sensitivity
from clgs.train.quality.rate_control import PIXELS
from clgs.train.state.run_state import ANCHOR_GROUPS, HostRows, render_settings
from clgs.train.state.voxel_grid import position_integers

Floats = npt.NDArray[np.float64]

COMPARED = 8
"""Views on which the loss and the squared error are measured."""


@dataclass(frozen=True)
class Judgement:
    """What the loss gains by changes of the anchors.

    loss: the mean over views; importance (A,): what leaving an anchor out adds; curvature: makes,
    by name, that of offset (A, K, 3), feature (A, F) and scaling (A, 6): what a change of one
    element by d adds, divided by d squared. Float64, at least 0. If anchors that no view showed
    must stay, their importance is infinite, and their curvature the mean of the others.
    """

    loss: float
    importance: Floats
    curvature: Callable[[str], Floats]


def look(
    device: Device,
    config: TrainConfig,
    scene: DeviceScene,
    views: Sequence[View],
    curved: bool = True,
) -> Sensitivity:
    """How the squared error of a picture depends on the anchors, the mean over ``views``.

    ``curved``: whether changes of the attributes are looked at, too.
    """
    least = min(view.camera.width * view.camera.height for view in views)
    factor = 2 if least >= 4 * PIXELS * len(scene.anchors) else 1
    reduced = [view.camera.reduced(factor) for view in views]
    used = [view.used(factor) for view in views]
    settings, options = render_settings(config), config.render_options()
    found = sensitivity(device, scene, settings, reduced, options, curved, used=used)
    return found.times(factor**2 / len(views))


def compare(
    device: Device, config: TrainConfig, scene: DeviceScene, views: Sequence[View]
) -> tuple[float, float]:
    """Loss and squared error of a view, means over some of ``views``."""
    settings, options = render_settings(config), config.render_options()
    weights = loss.Weights(config.l1_weight, config.ssim_weight)
    losses, errors, room = [], [], EXACT_ROOM
    for view in views[:: -(-len(views) // COMPARED)]:
        drawn = upload_view(device, view.camera, settings)
        frame, room = with_enough_room(rasterise, device, scene, drawn, options, room)
        photo = view.photo.planes(settings.background)
        image, used = frame.image, view.used()
        if used is not None:
            image, photo = mask.forward(device, image, device.upload(used)), photo * used
        compared = loss.forward(device, image, device.upload(photo), weights)
        losses.append(compared.value_later(device).get().value)
        residual = device.download(image) - photo / np.float32(255)
        errors.append(float(np.square(residual, dtype=np.float64).sum()))
        del frame, image  # before the next ones are made
    return float(np.mean(losses)), max(float(np.mean(errors)), np.finfo(np.float64).tiny)


def judge(
    found: Sensitivity, mean_loss: float, squared_error: float, unseen_stay: bool
) -> Judgement:
    """The anchors in units of the loss, by what :func:`look` and :func:`compare` found.

    ``unseen_stay``: there are more views, which may show what these do not.
    """
    worth = 0.5 * mean_loss / squared_error
    importance = found.importance.astype(np.float64) * worth
    unseen = unseen_stay and bool(found.seen.any())
    if unseen:
        importance[~found.seen] = np.inf

    def curvature(name: str) -> Floats:
        array = found.curvature[name].astype(np.float64) * worth
        if unseen:
            array[~found.seen] = array[found.seen].mean(axis=0)
        return array

    return Judgement(mean_loss, importance, curvature)


LEAST_SCALE = 0.05
"""The least scale of the Laplace law of a channel, in integers: constant channels stay so."""

SCALES_PER_OCTAVE = 4
"""Integers per unit are powers of the root of this order of 2."""

LEAST_POWER, MOST_POWER = 0, 8 * SCALES_PER_OCTAVE
"""Powers for 1 integer per unit, as the paper has for offsets and features, and for 256. With fewer
nearly all features are 0: one by one they seem worth less than their bits, all together they are
most of the picture.
"""

BLOCK = 256
"""Rows looked at at once: what is computed of them stays in a processor's cache."""

SAMPLED = 4096
"""The least number of rows that :func:`best_scale` looks at, if there are that many."""


@dataclass(frozen=True)
class LaplaceLaw:
    """What the integers of each channel cost in nats, see ``clgs.ops.rate``; (channels,) float64.

    Beyond half an integer from the mean the cost is linear in the distance, and only one integer,
    ``centre``, is nearer.
    """

    mean: Floats
    scale: Floats
    centre: Floats
    at_centre: Floats
    edge: Floats

    @classmethod
    def of(cls, integers: Floats) -> LaplaceLaw:
        """The law of the integers (A, channels): their mean, and mean distance from it."""
        mean = integers.mean(axis=0)
        scale = np.maximum(np.abs(integers - mean).mean(axis=0), LEAST_SCALE)
        centre = np.rint(mean)
        at_centre = rate.cost(np.abs(centre - mean), scale).nats
        edge = rate.cost(np.full_like(mean, 0.5), scale).nats
        return cls(mean, scale, centre, at_centre, edge)

    def nats(self, integers: Floats) -> Floats:
        """What each of the integers (A, channels) costs, in nats."""
        nats = np.subtract(integers, self.mean)
        np.abs(nats, out=nats)
        nats -= 0.5
        nats /= self.scale
        nats += self.edge
        np.copyto(nats, self.at_centre, where=integers == self.centre)
        return nats


def cheaper_integers(
    values: npt.NDArray[np.float32], curvature: Floats, q: float, price: float
) -> Floats:
    """The integers (A, ...) with the least sum of loss and bits, float64.

    Away from the mean, costs are linear and the optimum between the integers is a soft threshold;
    its neighbours are tried, the integer next to the mean, the one after it, and the nearest one.

    Args:
        values: (A, ...) an attribute before rounding; every index after the first is a channel,
            and an integer costs what the Laplace law of its channel says.
        curvature: of the loss by ``values``, as ``Judgement`` says.
        q: integers per unit.
        price: of a bit, in units of the loss.
    """
    rows, weights = values.reshape(len(values), -1), curvature.reshape(len(values), -1)
    law = LaplaceLaw.of(np.rint(rows.astype(np.float64) * q))
    best = np.empty(rows.shape)
    for start in range(0, len(rows), BLOCK):
        block = slice(start, start + BLOCK)
        exact, weight = rows[block].astype(np.float64) * q, weights[block] / q**2
        best[block] = _cheapest(exact, weight, price / np.log(2.0), law)
    return best.reshape(values.shape)


def _cheapest(exact: Floats, weight: Floats, nat: float, law: LaplaceLaw) -> Floats:
    """The integers near ``exact`` (A, channels) with the least sum of loss and bits.

    ``weight``: the curvature of the loss by integers; ``nat``: the price of a nat.
    """
    nearest, distance = np.rint(exact), exact - law.mean
    with np.errstate(divide="ignore", invalid="ignore"):
        threshold = np.nan_to_num(nat / law.scale / (2.0 * weight), nan=0.0, posinf=np.inf)
    side = np.sign(distance)
    soft = law.mean + side * np.maximum(np.abs(distance) - threshold, 0.0)
    middle = np.broadcast_to(law.centre, soft.shape)
    best, least = nearest, _sum(nearest - exact, weight, nat, law.nats(nearest))
    for candidate in (np.floor(soft), np.ceil(soft), middle, middle + side):
        cost = _sum(candidate - exact, weight, nat, law.nats(candidate))
        np.copyto(best, candidate, where=cost < least)
        np.minimum(cost, least, out=least)
    return best


def _sum(error: Floats, weight: Floats, nat: float, nats: Floats) -> Floats:
    """What an error of integers costs, and its bits; ``error`` and ``nats`` are used up."""
    np.square(error, out=error)
    error *= weight
    nats *= nat
    error += nats
    return error


def best_scale(values: npt.NDArray[np.float32], curvature: Floats, price: float) -> float:
    """The integers per unit with the least sum of loss and bits, a power of 2^(1/4).

    Arguments as for :func:`cheaper_integers`. The sum may have several minima: powers
    of 2 are tried first, then those around the best of them.
    """
    step = max(1, len(values) // SAMPLED)
    flat = values.reshape(len(values), -1)[::step].astype(np.float64)
    weight, nat = curvature.reshape(len(values), -1)[::step], price / np.log(2.0)

    def cost(power: int) -> float:
        q = 2.0 ** (power / SCALES_PER_OCTAVE)
        integers = np.multiply(flat, q)
        np.rint(integers, out=integers)
        nats = LaplaceLaw.of(integers).nats(integers)
        integers /= q
        integers -= flat
        return float(_sum(integers, weight, nat, nats).sum())

    octave = min(range(LEAST_POWER, MOST_POWER + 1, SCALES_PER_OCTAVE), key=cost)
    first, last = octave - SCALES_PER_OCTAVE + 1, octave + SCALES_PER_OCTAVE
    near = range(max(first, LEAST_POWER), min(last, MOST_POWER + 1))
    return float(2.0 ** (min(near, key=cost) / SCALES_PER_OCTAVE))


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
        return ~least_worth(self.worth, int(most * (len(self.worth) - 1)), self.price)

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


def least_worth(worth: Floats, count: int, price: float) -> npt.NDArray[np.bool_]:
    """Which (A,) are the ``count`` of least ``worth`` (A,), unless they are worth ``price``.

    Of equal ones the first: often many are worth nothing. What is no number goes.
    """
    found = np.zeros(len(worth), np.bool_)
    if count > 0:
        least = np.argsort(worth, kind="stable")[:count]
        found[least[worth[least] < price]] = True
        found |= np.isnan(worth)
    return found


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
