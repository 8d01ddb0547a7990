"""The in-place NumPy Adam."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from clgs.reference.stages import adam as reference
from clgs.train.step.numpy_adam import Adam
from tests.compare import assert_close


def test_follows_float64(rng):
    wide = rng.normal(size=(50, 6))
    parameter, group = wide.astype(np.float32), Adam((50, 6))
    moments = (np.zeros((50, 6)), np.zeros((50, 6)))
    size = 10.0 ** rng.uniform(-12, 5, (50, 6))
    for count in range(1, 1001):
        g = (rng.normal(size=(50, 6)) * size).astype(np.float32)
        wide, moments = reference.step(wide, g.astype(np.float64), moments, 1e-3, count)
        group.step(parameter, g, 1e-3)
    assert group.count == 1000
    assert_close(parameter, wide, 1e-5 * np.maximum(np.abs(wide), 1), "parameter")


def test_works_in_place():
    group = Adam((100_000, 5))
    parameter, gradient = np.ones((2, 100_000, 5), np.float32)
    before = group.first
    tracemalloc.start()
    group.step(parameter, gradient, 0.1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.2 * parameter.nbytes, "no temporaries of the parameter's size"
    assert group.first is before
    assert_close(parameter, np.full((100_000, 5), 0.9), 1e-6, "parameter")


def test_extreme_gradients_stay_finite():
    sizes = np.float32([0, 1e-30, 1e-20, 1e-10, 1, 1e10, -1e10, -1e-30])
    parameter, group = np.zeros(8, np.float32), Adam((8,))
    for _ in range(20):
        group.step(parameter, sizes, 0.01)
    assert np.isfinite(parameter).all()
    assert_close(parameter[3:7], [-0.2, -0.2, -0.2, 0.2], 1e-5, "parameter")


def test_idle_moments_become_zero():
    group, parameter = Adam((10,)), np.zeros(10, np.float32)
    group.step(parameter, np.full(10, 1e-3, np.float32), 0.01)
    for _ in range(700):
        group.step(parameter, np.zeros(10, np.float32), 0.01)
    assert not group.first.any()


def test_rows_come_and_go(rng):
    group, parameter = Adam((6, 2)), np.zeros((6, 2), np.float32)
    group.step(parameter, rng.normal(size=(6, 2)).astype(np.float32), 0.1)
    first = group.first.copy()
    keep = np.array([True, False, True, True, False, True])
    group.keep(keep)
    group.append(3)
    assert np.array_equal(group.first, np.concatenate([first[keep], np.zeros((3, 2))]))
    assert group.count == 1
    grown = np.zeros((7, 2), np.float32)
    group.step(grown, np.ones((7, 2), np.float32), 0.1)
    assert grown.all()


def test_wrong_shapes_are_refused():
    group = Adam((6, 2))
    with pytest.raises(ValueError, match="gradient"):
        group.step(np.zeros((6, 2), np.float32), np.zeros((6, 3), np.float32), 0.1)
    with pytest.raises(ValueError, match="parameter"):
        group.step(np.zeros((6, 2)), np.zeros((6, 2), np.float32), 0.1)
