"""Prices: what one leaves of anchors, which one leaves a size, and applying it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.errors import ClgsError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.train.rate.pricing import (
    LEAST_PRICE,
    Judgement,
    PricedAnchors,
    Situation,
    priced,
    priced_for_size,
    priced_within_loss,
)
from tests.train.step.density_cases import state_at

COUNT = 40
SCALES = QuantizationScales(position=2.0, offset=2.0, feature=2.0, scaling=2.0)


@pytest.fixture
def state(rng):
    state = state_at(np.arange(3 * COUNT).reshape(COUNT, 3))
    for name, array in state.anchors.items():
        if name != "position":
            array[...] = rng.laplace(0, 2, array.shape)
    return state


@pytest.fixture
def now(state, rng):
    curvature = {
        name: 10.0 ** rng.uniform(-9, -5, one.first.shape) for name, one in state.moments.items()
    }
    importance = 10.0 ** rng.uniform(-9, -3, COUNT)
    return Situation(state.anchors, Judgement(0.1, importance, curvature.__getitem__), SCALES)


def measure(anchors: QuantizedAnchors, scales: QuantizationScales) -> int:
    """Stands in for the encoder: grows with the anchors and with the size of their integers."""
    names = ("offset", "feature", "scaling")
    return int(sum(np.log2(1 + np.abs(getattr(anchors, name))).sum() for name in names))


def test_bits_for_nothing_change_nothing(now, state):
    offer = priced(0.0, now)
    assert len(offer.kept) == COUNT
    before = state.anchors.map(np.copy)
    changed, kept = offer.apply(state, 0.2)
    assert changed == 0
    assert kept.all()
    for name, array in before.items():
        np.testing.assert_array_equal(array, getattr(state.anchors, name))


def test_dearer_bits_leave_less(now):
    sizes = []
    for price in (1e-9, 1e-7, 1e-5):
        offer = priced(price, now)
        sizes.append((len(offer.kept), measure(offer.integers, offer.scales)))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > sizes[-1]


def test_only_free_scales_change(now):
    free = Situation(now.anchors, now.judged, SCALES, frozenset({"feature"}))
    offer = priced(1e-6, free)
    assert offer.scales.feature != SCALES.feature
    assert (offer.scales.offset, offer.scales.scaling) == (SCALES.offset, SCALES.scaling)


def test_a_price_that_loses_too_much_is_lowered(now):
    tried = []

    def loss(offer: PricedAnchors) -> float:
        tried.append(offer.price)
        return max(offer.price, 1e-8)

    offer = priced_within_loss(30.0, 1e-6, now, loss)
    assert tried == [LEAST_PRICE, 1e-6, 5e-7, 2.5e-7]
    for name in ("offset", "feature", "scaling"):
        wanted = getattr(priced(2.5e-7, now).integers, name)
        np.testing.assert_array_equal(getattr(offer.integers, name), wanted)
    assert priced_within_loss(100.0, 1e-6, now, loss).price == 1e-6
    assert 0 < priced_within_loss(0.5, 1e-6, now, loss).price <= LEAST_PRICE


@pytest.mark.parametrize("share", [0.9, 0.5, 0.2])
def test_a_size_is_met_from_below(now, share):
    whole = priced(0.0, now)
    size = int(share * measure(whole.kept, whole.scales))
    offer = priced_for_size(size, now, measure)
    found = measure(offer.kept, offer.scales)
    assert found <= size
    cheaper = priced(offer.price * 0.9, now)
    assert measure(cheaper.kept, cheaper.scales) >= found


def test_a_size_that_holds_everything_is_seen_soon(now):
    measured = []

    def counted(anchors: QuantizedAnchors, scales: QuantizationScales) -> int:
        measured.append(len(anchors))
        return measure(anchors, scales)

    offer = priced_for_size(10**9, now, counted)
    assert offer.price == LEAST_PRICE
    assert len(measured) <= 5


def test_what_is_applied(now, state):
    offer = priced(3e-6, now)
    integers, rows = offer.integers, np.flatnonzero(offer.worth >= offer.price)
    first = {name: moments.first.copy() for name, moments in state.moments.items()}
    rounded = {name: np.rint(getattr(state.anchors, name) * 2.0) for name in first}
    changed, kept = offer.apply(state, 1.0)
    np.testing.assert_array_equal(np.flatnonzero(kept), rows)
    assert changed == sum(int((rounded[n] != getattr(integers, n)).sum()) for n in first)
    assert 0 < len(rows) < COUNT
    for name, moments in first.items():
        values, wanted = getattr(state.anchors, name), getattr(integers, name)
        np.testing.assert_array_equal(np.rint(values * 2.0), wanted[rows])
        still = (rounded[name] == wanted)[rows]
        np.testing.assert_array_equal(state.moments[name].first[still], moments[rows][still])
        assert (state.moments[name].first[~still] == 0).all()


def test_at_most_a_share_goes(now, state):
    offer = priced(1.0, now)
    assert len(offer.kept) == 0
    before = state.anchors.position[:, 0].copy()
    offer.apply(state, 0.25)
    assert 0.75 * COUNT <= len(state.anchors) <= 0.75 * COUNT + 1
    assert np.isin(state.anchors.position[:, 0], before).all()


def test_of_anchors_that_are_worth_nothing_a_share_goes(now, state):
    offer = priced(1.0, now)
    offer = replace(offer, worth=np.where(np.arange(COUNT) % 2, 0.0, 2.0))
    _, kept = offer.apply(state, 0.25)
    gone = np.flatnonzero(~kept)
    np.testing.assert_array_equal(gone, 2 * np.arange(len(gone)) + 1)  # the first of equal ones
    assert len(gone) in (0.25 * COUNT - 1, 0.25 * COUNT)


def test_something_must_be_left(now, state):
    offer = priced(1.0, now)
    with pytest.raises(ClgsError, match="no anchors"):
        replace(offer, worth=np.full(COUNT, np.nan)).apply(state, 1.0)
