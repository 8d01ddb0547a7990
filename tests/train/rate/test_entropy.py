"""Bits of integers by the frequencies of their channels."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.train.rate.entropy import entropy_bits


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
