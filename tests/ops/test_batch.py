"""Gradients of a batch on the device against the float64 mean, on both specialisations."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import batch
from clgs.reference import batch as reference

SHAPES = [(1,), (15,), (17, 10, 3), (1000, 6), (0, 3)]
EPSILON = 2.0**-24


def added(device, gradients):
    """The mean of the gradients as training adds it up."""
    total = device.upload(gradients[0])
    for number, gradient in enumerate(gradients[1:], 2):
        scale = 1 / len(gradients) if number == len(gradients) else 1.0
        batch.add(device, total, device.upload(gradient), scale)
    return device.download(total)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("views", [2, 3, 8])
def test_agrees_with_reference(device, rng, shape, views):
    gradients = rng.normal(size=(views, *shape)).astype(np.float32)
    wanted = reference.mean(list(gradients.astype(np.float64)))
    # every sum and the product round once, relative to what was added up so far
    bound = views * EPSILON * np.abs(gradients.astype(np.float64)).sum(axis=0)
    assert (np.abs(added(device, gradients) - wanted) <= bound).all()


def test_bits_are_those_of_float32_in_order(device, rng):
    gradients = (rng.normal(size=(3, 777)) * 10.0 ** rng.integers(-6, 6, 777)).astype(np.float32)
    wanted = ((gradients[0] + gradients[1]) + gradients[2]) * np.float32(1 / 3)
    assert np.array_equal(added(device, gradients), wanted)
    assert not np.array_equal(added(device, gradients[[0, 2, 1]]), wanted)  # the order counts


def test_not_a_number_stays_one(device):
    gradients = np.zeros((2, 40), np.float32)
    gradients[1, 7] = np.nan
    assert np.array_equal(np.isnan(added(device, gradients)), np.arange(40) == 7)


def test_wrong_arrays_are_refused(device):
    three, four = device.zeros((3,)), device.zeros((4,))
    with pytest.raises(ValueError, match="gradient"):
        batch.add(device, three, four)
    with pytest.raises((ValueError, TypeError), match="gradient"):
        batch.add(device, three, device.zeros((3,), np.int32))
