"""Integers that are cheaper to store, if the loss forgives the difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.ops import rate

Floats = npt.NDArray[np.float64]

LEAST_SCALE = 0.05
"""The least scale of the Laplace law of a channel, in integers: constant channels stay so."""

SCALES_PER_OCTAVE = 4
"""Integers per unit are powers of the root of this order of 2."""

LEAST_POWER, MOST_POWER = -2 * SCALES_PER_OCTAVE, 8 * SCALES_PER_OCTAVE
"""Powers for 1/4 and for 256 integers per unit."""

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
        half = np.full_like(mean, 0.5)
        return cls(
            mean,
            scale,
            centre,
            rate.cost(np.abs(centre - mean), scale).nats,
            rate.cost(half, scale).nats,
        )

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
