"""Cheaper integers against a search of all integers; scales against their neighbours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.reference.rate import laplace_nats
from clgs.train.rate.pricing import (
    LEAST_POWER,
    LEAST_SCALE,
    MOST_POWER,
    SCALES_PER_OCTAVE,
    LaplaceLaw,
    best_scale,
    cheaper_integers,
)

Floats = npt.NDArray[np.float64]


def nats_of(integers: Floats, nearest: Floats) -> Floats:
    """The float64 reference's nats, under the law of ``nearest``."""
    mean = nearest.mean(axis=0)
    scale = np.maximum(np.abs(nearest - mean).mean(axis=0), LEAST_SCALE)
    return laplace_nats(np.abs(integers - mean), np.broadcast_to(scale, integers.shape))


def drawn(seed: int, spread: float) -> tuple[npt.NDArray[np.float32], Floats]:
    rng = np.random.default_rng(seed)
    values = rng.laplace(0.3, spread, (60, 3)).astype(np.float32)
    curvature = 10.0 ** rng.uniform(-6, 0, values.shape)
    curvature[rng.random(values.shape) < 0.1] = 0.0
    return values, curvature


@given(
    seed=st.integers(0, 1000),
    spread=st.sampled_from([0.01, 0.6, 4.0]),
    q=st.sampled_from([0.5, 1.0, 8.0]),
    price=st.sampled_from([0.0, 1e-5, 1e-2]),
)
@settings(max_examples=40, deadline=None)
def test_no_integer_costs_less(seed, spread, q, price):
    values, curvature = drawn(seed, spread)
    found = cheaper_integers(values, curvature, q, price)
    exact = values.astype(np.float64) * q
    nearest = np.rint(exact)

    def cost(integers: Floats) -> Floats:
        bits = nats_of(integers, nearest) / np.log(2.0)
        return curvature / q**2 * np.square(integers - exact) + price * bits

    every = np.arange(nearest.min() - 1, nearest.max() + 2)
    costs = np.stack([cost(np.full(values.shape, integer)) for integer in every])
    assert (found == np.rint(found)).all()
    np.testing.assert_array_less(cost(found), costs.min(axis=0) * (1 + 1e-9) + 1e-12)
    if price == 0.0:
        free = curvature == 0.0
        np.testing.assert_array_equal(found[~free], nearest[~free])


@pytest.mark.parametrize("shape", [(40, 10, 3), (40, 6)])
def test_keeps_the_shape(shape, rng):
    values = rng.normal(size=shape).astype(np.float32)
    assert cheaper_integers(values, np.ones(shape), 4.0, 0.1).shape == shape


def test_a_law_gives_the_nats_of_the_reference(rng):
    integers = np.rint(rng.laplace(2.2, [0.0, 0.2, 1.0, 30.0], (300, 4)))
    wanted = nats_of(integers, integers)
    np.testing.assert_allclose(LaplaceLaw.of(integers).nats(integers), wanted, rtol=1e-12)


@pytest.mark.parametrize("price", [1e-7, 1e-5, 1e-3])
def test_the_best_scale_is_no_worse_than_any_other(price, rng):
    values = rng.laplace(0.0, 1.5, (3000, 4)).astype(np.float32)
    curvature = 10.0 ** rng.uniform(-5, -3, values.shape)

    def cost(q: float) -> float:
        integers = np.rint(values.astype(np.float64) * q)
        loss = (curvature * np.square(integers / q - values)).sum()
        return float(loss + price * nats_of(integers, integers).sum() / np.log(2.0))

    found = best_scale(values, curvature, price)
    tried = [2.0 ** (power / SCALES_PER_OCTAVE) for power in range(LEAST_POWER, MOST_POWER + 1)]
    assert found in tried
    assert cost(found) <= 1.0001 * min(map(cost, tried))


def test_no_price_makes_integers_coarser_than_the_units_of_the_paper(rng):
    # By single values 1/4 would be cheaper: nearly all would be 0, and the picture gone.
    values = rng.laplace(0.0, 1.5, (3000, 4)).astype(np.float32)
    assert best_scale(values, np.full(values.shape, 1e-5), 1e-2) == 1.0


def test_values_near_integers_do_not_hold_the_scale_at_one(rng):
    # At one integer per unit all share one integer; a little finer, they all lie between two.
    values = (rng.uniform(-0.05, 0.05, (500, 6)) - 4.0).astype(np.float32)
    curvature = np.full(values.shape, 1.0)
    assert best_scale(values, curvature, 1e-6) >= 32.0


def test_dearer_bits_make_coarser_scales(rng):
    values = rng.laplace(0.0, 1.5, (500, 4)).astype(np.float32)
    curvature = np.full(values.shape, 1e-4)
    fine, coarse = (best_scale(values, curvature, price) for price in (1e-7, 1e-4))
    assert fine > coarse
