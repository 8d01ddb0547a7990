"""Cuts of a scene into blocks: every anchor has one owner, and blocks contribute about the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgs.cluster.block_plan import Cuts, bulk, cut_scene, long_axes, parse_counts
from clgs.errors import UsageError

UP = np.array([0.1, -0.9, 0.2])


def anchors(seed, count=400, spans=(90, 30, 50)):
    """Integer positions and contributions: few anchors make up most."""
    rng = np.random.default_rng(seed)
    position = rng.integers(-np.array(spans), np.array(spans), (count, 3)).astype(np.int32)
    return position, rng.exponential(1.0, count) ** 3


@given(st.integers(0, 2**32), st.integers(1, 4), st.integers(1, 4))
def test_every_anchor_lies_in_the_block_that_owns_it_and_in_no_other(seed, rows, columns):
    position, weight = anchors(seed)
    cuts = cut_scene(position, weight, UP, (rows, columns))
    owner = cuts.owner(position)
    boxes = [cuts.box(number, margin=False) for number in range(rows * columns)]
    inside = np.stack([box.holds(position) for box in boxes])
    np.testing.assert_array_equal(inside.sum(axis=0), 1)
    np.testing.assert_array_equal(inside.argmax(axis=0), owner)
    assert set(owner) == set(range(rows * columns))
    wider = [cuts.box(number, margin=True).holds(position) for number in range(rows * columns)]
    assert (np.stack(wider) >= inside).all()
    assert Cuts.restore(cuts.record()) == cuts


@pytest.mark.parametrize("counts", [(2, 1), (1, 2), (2, 2), (3, 4)])
def test_blocks_contribute_about_the_same(counts):
    position, weight = anchors(1, 20_000, (3000, 200, 2000))
    weight = np.minimum(weight, 5.0)
    cuts = cut_scene(position, weight, UP, counts)
    shares = np.bincount(cuts.owner(position), weight) / weight.sum()
    assert np.abs(shares * len(shares) - 1).max() < 0.05
    assert cuts.axes == (0, 2)
    assert cuts.counts == counts


def test_the_vertical_axis_is_not_cut_and_far_anchors_do_not_count():
    position, weight = anchors(2)
    assert long_axes(position, weight, np.array([0.0, 1.0, 0.0])) == (0, 2)
    assert long_axes(position, weight, np.array([-1.0, 0.3, 0.0])) == (2, 1)
    far = np.append(position[:, 1], np.int32(1_000_000))
    assert bulk(far, np.append(weight, 0.001)) < 70


def test_margins_are_a_tenth_of_a_block():
    position, weight = anchors(3, 20_000, (1000, 10, 500))
    cuts = cut_scene(position, np.ones_like(weight), UP, (2, 5))
    assert cuts.margin == pytest.approx((0.1 * 1920 / 2, 0.1 * 960 / 5), rel=0.02)
    inner, outer = cuts.box(1, margin=False), cuts.box(1, margin=True)
    assert inner.lower[2] - outer.lower[2] == pytest.approx(cuts.margin[1])
    assert outer.lower[0] == -np.inf


@pytest.mark.parametrize("text", ["0x2", "2x0", "2", "x", "2x2x2", "-1x2", "two", "", "1x1"])
def test_what_are_no_blocks_is_one_line(text):
    with pytest.raises(
        UsageError, match=r"^--blocks .*: is (not NxM, such as 2x2|the whole scene)"
    ):
        parse_counts(text)


def test_more_blocks_than_places_are_refused():
    position = np.array([[0, 0, 0], [1, 5, 3], [1, 7, 9]], np.int32)
    with pytest.raises(UsageError, match=r"lie at 3 places along an axis, too few for 4 blocks"):
        cut_scene(position, np.ones(3), UP, (4, 1))
    assert parse_counts("4X1") == (4, 1)
    assert parse_counts("auto") is None


@pytest.mark.parametrize(
    "record",
    [
        {},
        {"axes": [0, 3], "rows": [], "columns": [[]], "margin": [0, 0]},
        {"axes": [0, 2], "rows": [1.5], "columns": [[]], "margin": [0, 0]},
        {"axes": [0, 2], "rows": ["a"], "columns": [[]], "margin": [0, 0]},
    ],
)
def test_damaged_records_are_noticed(record):
    with pytest.raises((ValueError, KeyError, TypeError)):
        Cuts.restore(record)
