"""The kernels that only use the device do the work that they are timed for."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.lab import kernels as limits
from clgs.opencl.grid import ANY_GROUP


@pytest.mark.parametrize("count", [0, 16, 4097])
def test_copy(device, rng, count):
    x = rng.normal(size=count).astype(np.float32)
    target = device.zeros((count,))
    limits.copy(device, device.upload(x), target)
    assert np.array_equal(device.download(target), x)


@pytest.mark.parametrize("steps", [0, 1, 1000])
def test_fma(device, steps):
    sums = device.download(limits.fma(device, 3, steps))
    # by the closed form: x approaches term / (1 - factor) geometrically
    limit = limits.TERM / (1 - limits.FACTOR)
    start = np.arange(1, limits.CHAINS + 1) / 8
    wanted = np.sum(limit + (start - limit) * limits.FACTOR**steps)
    # a step keeps 3/4 of the error before it and adds a rounding of values below 2
    assert np.all(np.abs(sums - wanted) <= limits.CHAINS * 8 * 2.0**-24)
    assert len(sums) == 3 * device.vec * (ANY_GROUP if device.vec == 1 else 1)


def test_copy_refuses_other_sizes(device):
    with pytest.raises(ValueError, match="target"):
        limits.copy(device, device.zeros((3,)), device.zeros((4,)))


@pytest.mark.parametrize("count", [0, 16, 4097])
def test_roundings_are_those_of_ieee_754(device, rng, count):
    x, y = rng.uniform(1, 2, (2, count)).astype(np.float32)
    z = -rng.uniform(1, 4, count).astype(np.float32)
    found = device.download(limits.rounding(device, *map(device.upload, (x, y, z))))
    assert np.array_equal(found, limits.exact_rounding(*map(np.float64, (x, y, z))))
    # NumPy rounds twice where it is not fused
    assert np.array_equal(found[:3], [x / y, np.sqrt(y), x * y + z])
    assert not count or not np.array_equal(found[2], found[3])


def test_roundings_of_other_lengths_are_refused(device):
    x, y = device.zeros((3,)), device.zeros((4,))
    with pytest.raises(ValueError, match="y"):
        limits.rounding(device, x, y, x)
