"""Histograms, Laplace laws and bits of a scene's integers."""

from __future__ import annotations

import numpy as np
import pytest
from reproduce.measure import ATTRIBUTES, bits, histogram, integers, laplace_mass

from clgs.codec.scene_encoder import encode
from tests.codec.scenes import random_scene


def test_mass_of_a_laplace_law():
    # b = 1: the middle integer has 1 - exp(-1/2), its neighbours sinh(1/2) exp(-1)
    found = laplace_mass(np.arange(-1, 2), np.zeros(1), np.full(1, np.sqrt(2)))
    side = np.sinh(0.5) * np.exp(-1)
    np.testing.assert_allclose(found, [side, 1 - np.exp(-0.5), side], rtol=1e-12)


def test_mass_of_channels_is_their_mean():
    means, deviations = np.array([0.0, 3.0]), np.array([0.0, 1.0])
    values = np.arange(-20, 20)
    both = laplace_mass(values, means, deviations)
    single = [laplace_mass(values, means[i : i + 1], deviations[i : i + 1]) for i in (0, 1)]
    np.testing.assert_allclose(both, np.mean(single, axis=0), rtol=1e-12)
    assert single[0][20] == pytest.approx(1.0)  # all equal: all mass on one integer
    assert both.sum() == pytest.approx(1.0)


def test_histogram_counts_integers(rng):
    rows = np.rint(rng.laplace(2.0, 3.0, (4000, 5))).astype(np.int32)
    found = histogram(rows)
    values = np.arange(found["first"], found["first"] + len(found["share"]))
    assert found["share"] == pytest.approx([(rows == value).mean() for value in values])
    assert sum(found["share"]) + found["outside"] == pytest.approx(1.0)
    assert 0 <= found["outside"] <= 0.002
    # 20,000 draws: shares are within 6 of their standard deviations, at most sqrt(0.25 / 20,000)
    for law in ("pooled", "channel"):
        assert np.abs(np.subtract(found[law], found["share"])).max() <= 6 * np.sqrt(0.25 / 20000)


def test_histogram_of_no_anchors_is_empty():
    assert histogram(np.empty((0, 5), np.int32))["share"] == []


def test_histogram_of_equal_integers_is_one_bar():
    found = histogram(np.full((10, 2), 7, np.int32))
    assert (found["first"], found["share"]) == (6, [0.0, 1.0, 0.0])
    assert found["channel"] == pytest.approx([0.0, 1.0, 0.0])


def test_bits_of_proxy_and_file(open_device, rng):
    scene = random_scene(rng)
    found = bits(open_device("cpu"), scene)
    assert set(found) == {
        "proxy_classes",
        "proxy_entropy",
        "proxy_channel",
        "proxy_pooled",
        "paper",
        "default",
    }
    assert all(set(one) == set(ATTRIBUTES) for one in found.values())
    assert all(value > 0 for one in found.values() for value in one.values())
    assert sum(found["default"].values()) < 8 * len(encode(scene))
    assert integers(scene)["offset"].shape == (len(scene.anchors), 30)
