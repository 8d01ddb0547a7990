"""Nearest descriptors on the device are those of the integer reference, in both forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgs.opencl.device import Device
from clgs.ops import match
from clgs.reference import match as reference


def sift_like(rng, count):
    """Descriptors whose square is about 2^18, as those of SIFT."""
    x = np.abs(rng.standard_normal((count, match.LENGTH))) ** 1.5
    return np.minimum(512 * x / np.linalg.norm(x, axis=1, keepdims=True), 255).astype(np.uint8)


def nearest(device, photos, pairs):
    uploaded = match.upload(device, photos)
    return match.nearest(device, uploaded, uploaded, pairs)


def assert_equal(found, own, other):
    index, product, second = reference.nearest(own, other)
    assert np.array_equal(found.index, index)
    assert np.array_equal(found.product, product)
    assert np.array_equal(found.second, second)


@pytest.mark.parametrize("counts", [(1, 1), (16, 64), (63, 65), (200, 17), (333, 1100)])
def test_agrees_with_reference(device, rng, counts):
    photos = [sift_like(rng, count) for count in counts]
    photos[1][: len(photos[1]) // 2] = photos[0][rng.integers(0, counts[0], counts[1] // 2)]
    both = nearest(device, photos, [(0, 1), (1, 0)])
    assert_equal(both[0], *photos)
    assert_equal(both[1], *photos[::-1])


def test_a_thousand_pairs_agree_with_reference(device, rng):
    photos = [sift_like(rng, count) for count in rng.integers(0, 90, 46)]
    pairs = [(a, b) for a in range(46) for b in range(a)][:1000]
    for (a, b), found in zip(pairs, nearest(device, photos, pairs), strict=True):
        assert_equal(found, photos[a], photos[b])


@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
def test_equal_descriptors_and_zeros(device, data, seed):
    """Ties: the first one counts; blank descriptors, and photos without any."""
    rng = np.random.default_rng(seed)
    few = np.concatenate([sift_like(rng, 2), np.zeros((1, match.LENGTH), np.uint8)])
    choice = st.lists(st.integers(0, 2), max_size=80)
    photos = [few[data.draw(choice)].reshape(-1, match.LENGTH) for _ in range(2)]
    (found,) = nearest(device, photos, [(0, 1)])
    assert_equal(found, *photos)


@pytest.mark.slow
def test_lanes_and_forms_give_the_same(rng, monkeypatch):
    photos = [sift_like(rng, 500), sift_like(rng, 700)]
    results = []
    for form, lanes in (("cpu", "16"), ("cpu", "8"), ("gpu", "")):
        monkeypatch.setenv("CLGS_LANES", lanes)
        device = Device(specialisation=form)
        results += nearest(device, photos, [(0, 1)])
    for one in results:
        assert_equal(one, *photos)


def test_the_longest_descriptor_is_exact(device):
    own = np.zeros((3, match.LENGTH), np.uint8)
    own[0, :8] = 255
    own[1, :9] = 240
    assert match.MAX_PRODUCT > 255**2 * 8
    (found,) = nearest(device, [own], [(0, 0)])
    assert_equal(found, own, own)


def test_no_pairs(device):
    assert nearest(device, [], []) == []


@pytest.mark.parametrize(
    ("photo", "message"),
    [
        (np.zeros((3, 64), np.uint8), r"photos\[0\]: shape is \(3, 64\)"),
        (np.zeros((3, 128), np.float32), r"dtype is float32, expected uint8"),
        (np.full((1, 128), 255, np.uint8), "square is 8323200"),
        (np.zeros((match.MAX_DESCRIPTORS + 1, 128), np.uint8), "at most 65536 are compared"),
    ],
)
def test_bad_descriptors_are_refused(device, photo, message):
    with pytest.raises((ValueError, TypeError), match=message):
        match.upload(device, [photo])
