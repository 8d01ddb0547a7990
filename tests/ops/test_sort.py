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


@pytest.mark.parametrize("count", [0, 1, 256, 40_001])
@pytest.mark.parametrize("bits", [1, 10, 11, 32])
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


def check_chosen(device, keys, choice):
    order = sort.chosen(device, device.upload(keys), device.upload(choice))
    found = device.download(order.index)[: device.download(order.count)[0]]
    assert np.array_equal(found, reference.chosen(keys, choice))


@pytest.mark.parametrize("bits", [0, 1, 13, 14, 26, 27, 32])
@pytest.mark.parametrize("count", [0, 3, 40_001])
def test_chosen_items_in_order(device, rng, count, bits):
    """Ranges of keys that need two passes, three passes and none at all."""
    low = int(rng.integers(0, 2**32 - 2**bits + 1))
    keys = low + rng.integers(0, 2**bits, count, dtype=np.uint64)
    keys[:1], keys[1:2] = low, low + 2**bits - 1
    keys = np.minimum(keys, 2**32 - 2).astype(np.uint32)
    check_chosen(device, keys, rng.integers(0, 4, count, dtype=np.int32))


def test_none_and_all_chosen(device, rng):
    keys = rng.integers(0, 2**20, 5000, dtype=np.uint32)
    for choice in (0, 1):
        check_chosen(device, keys, np.full(5000, choice, np.int32))


def test_keys_that_are_not_chosen_do_not_count(device):
    """Neither in the range of the keys nor in the order."""
    keys = np.array([2**32 - 1, 7, 0, 5, 7, 2**31], np.uint32)
    check_chosen(device, keys, np.array([0, 1, 0, 9, 1, 0], np.int32))


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(keys=st.lists(st.integers(0, 2**32 - 1), max_size=300), bits=st.integers(0, 32))
def test_any_keys(device, keys, bits):
    check(device, np.array(keys, np.uint32), bits)


@pytest.mark.parametrize("bits", [-1, 33])
def test_impossible_bits_are_refused(device, bits):
    empty = device.empty((0,), np.uint32), device.empty((0,), np.int32)
    with pytest.raises(ValueError, match="bits"):
        sort.by_key(device, *empty, bits)
