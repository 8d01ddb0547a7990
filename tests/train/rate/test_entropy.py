"""Bits of integers by the frequencies of their channels."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.train.rate.rate_term import (
    CLASSES,
    activity_classes,
    class_bits,
    coded_bits,
    entropy_bits,
)


def test_equal_integers_take_no_bits():
    assert entropy_bits(np.full((50, 3, 2), -7)) == 0.0
    assert entropy_bits(np.zeros((0, 4), np.int32)) == 0.0


def test_known_frequencies():
    fair = np.array([[0, 5], [1, 5], [0, 6], [1, 5]])
    assert entropy_bits(fair) == pytest.approx(4 + 4 * 0.8112781244591328)


@pytest.mark.parametrize("times", [1, 10**8], ids=["near", "far apart"])
def test_bits_are_those_of_frequencies_in_random_integers(rng, times):
    integers = times * rng.integers(-3, 4, (40, 5)).astype(np.int32)
    wanted = 0.0
    for channel in integers.T.tolist():
        for value in channel:
            wanted -= np.log2(channel.count(value) / len(channel))
    assert entropy_bits(integers) == pytest.approx(wanted, rel=1e-12)


def test_classes_hold_equally_many_anchors_by_size(rng):
    integers = rng.integers(-50, 51, (1600, 6))
    classes = activity_classes(integers)
    assert np.bincount(classes, minlength=CLASSES).min() >= 80
    size = np.abs(integers).mean(axis=1)
    for one in range(1, CLASSES):
        assert size[classes < one].max() <= size[classes >= one].min()
    assert activity_classes(np.zeros((0, 6), np.int64)).shape == (0,)


def test_bits_of_classes_are_those_of_their_frequencies(rng):
    integers = rng.integers(-3, 4, (400, 5)).astype(np.int32)
    classes = rng.integers(0, 3, 400)
    wanted = 0.0
    for one in range(3):
        rows = integers[classes == one]
        wanted += entropy_bits(rows)
        for channel in rows.T.tolist():
            wanted += (len(set(channel)) - 1) * 0.5 * np.log2(len(channel))
    assert class_bits(integers, classes) == pytest.approx(wanted, rel=1e-12)
    wide = 10**6 * integers
    assert class_bits(wide, classes) == pytest.approx(entropy_bits(wide), rel=1e-12)


def test_anchors_of_different_size_take_less(rng):
    spread = np.repeat([0.2, 20.0], 1000)[:, None]
    integers = {
        name: np.rint(rng.normal(size=(2000, width)) * spread).astype(np.int32)
        for name, width in (("offset", 30), ("feature", 50), ("scaling", 6))
    }
    found = coded_bits(integers)
    for name, rows in integers.items():
        assert found[name] < 0.95 * entropy_bits(rows)
    alike = {name: rng.integers(-9, 10, rows.shape) for name, rows in integers.items()}
    for name, bits in coded_bits(alike).items():
        assert bits == pytest.approx(entropy_bits(alike[name]), rel=1e-12)
