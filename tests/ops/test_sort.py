"""Radix sort: exact equality with a stable sort."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clgs.ops import sort
from clgs.reference import sort as reference


def check(device, keys, bits):
    values = np.arange(len(keys), dtype=np.int32)
    actual = sort.by_key(device, device.upload(keys), device.upload(values), bits)
    expected = reference.by_key(keys, values, bits)
    for one, other in zip(actual, expected, strict=True):
        assert np.array_equal(device.download(one), other)


@pytest.mark.parametrize("count", [0, 1, 2, 256, 1000, 40_001])
@pytest.mark.parametrize("bits", [1, 8, 10, 11, 12, 17, 32])
def test_equals_stable_sort(device, rng, count, bits):
    check(device, rng.integers(0, 2**32, count, dtype=np.uint32), bits)


def test_ties_keep_their_order(device, rng):
    check(device, rng.integers(0, 5, 30_000, dtype=np.uint32), 3)


def test_no_bits_keep_the_order(device):
    check(device, np.array([3, 1, 2], np.uint32), 0)


def test_float_bits_order_positive_depths(device, rng):
    depth = np.concatenate([10.0 ** rng.uniform(-40, 38, 5000), [0, 1e-45, 1e-6, 1e6, 1, 1]])
    depth = depth.astype(np.float32)
    keys, order = sort.by_key(
        device,
        device.upload(depth.view(np.uint32)),
        device.upload(np.arange(len(depth), dtype=np.int32)),
    )
    assert np.array_equal(device.download(order), np.argsort(depth, kind="stable"))
    assert np.array_equal(device.download(keys).view(np.float32), np.sort(depth))


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(keys=st.lists(st.integers(0, 2**32 - 1), max_size=300), bits=st.integers(0, 32))
def test_any_keys(device, keys, bits):
    check(device, np.array(keys, np.uint32), bits)


@pytest.mark.parametrize("bits", [-1, 33])
def test_impossible_bits_are_refused(device, bits):
    empty = device.empty((0,), np.uint32), device.empty((0,), np.int32)
    with pytest.raises(ValueError, match="bits"):
        sort.by_key(device, *empty, bits)
