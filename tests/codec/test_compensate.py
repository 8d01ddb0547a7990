"""Rounding whose errors make up for each other, against rounding of single values."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.codec.smaller import compensated, hidden_products
from clgs.scene.mlps import MLP_SIZE, Mlps, init_mlps


def cost(rounded: np.ndarray, values: np.ndarray, products: np.ndarray) -> float:
    errors = rounded - values
    return float(np.einsum("ai,ij,aj->", errors, products, errors))


def test_errors_make_up_for_each_other(rng: np.random.Generator) -> None:
    """Sums of many channels are what counts: each is hit within the damping."""
    values = rng.laplace(0, 1, (500, 50))
    some = rng.normal(size=(50, 5))
    products = some @ some.T
    found = compensated(values, products)
    np.testing.assert_array_equal(found, np.rint(found))
    assert np.abs(found - values).max() < 3
    nearest = np.rint(values)
    assert cost(found, values, products) < 0.1 * cost(nearest, values, products)


@pytest.mark.parametrize("scale", [0.0, 1e-30, 1.0, 1e30])
def test_errors_that_do_not_meet_stay_as_they_are(rng: np.random.Generator, scale: float) -> None:
    values = rng.laplace(0, 2, (100, 50))
    products = scale * np.diag(rng.uniform(0, 1, 50))
    np.testing.assert_array_equal(compensated(values, products), np.rint(values))


def test_integers_and_scenes_without_anchors_stay(rng: np.random.Generator) -> None:
    products = hidden_products(init_mlps(rng))
    values = rng.integers(-9, 9, (40, 50)).astype(np.float64)
    for some in (values, values[:0]):
        np.testing.assert_array_equal(compensated(some, products), some)


def test_networks_say_how_errors_meet(rng: np.random.Generator) -> None:
    mlps = init_mlps(rng)
    error = rng.normal(size=50)
    hidden = [mlps.head(head)["hidden_weight"][:, :50] @ error for head in ("opacity", "color")]
    hidden.append(mlps.head("covariance")["hidden_weight"][:, :50] @ error)
    expected = sum(float(np.square(each).sum()) for each in hidden)
    assert error @ hidden_products(mlps) @ error == pytest.approx(expected, rel=1e-5)
    assert not hidden_products(Mlps(np.zeros(MLP_SIZE, np.float32))).any()
