"""Which pairs of photos speak for or against a model."""

from __future__ import annotations

import numpy as np

from clgs.poses.evidence import LINKS, Evidence, Explained, MatchedPair


def pair(first: int, second: int, count: int) -> MatchedPair:
    return MatchedPair(first, second, np.zeros((count, 2), np.uint32))


def walk(count: int, alike: int) -> Evidence:
    """Photos whose neighbours share much; all others share ``alike`` matches."""
    matches = {1: 1600, 2: 1000}
    pairs = [
        pair(i, j, matches.get(j - i, alike)) for i in range(count) for j in range(i + 1, count)
    ]
    return Evidence(pairs, {})


def test_links_are_the_best_pairs_of_either_photo():
    links = {(one.first, one.second) for one in walk(20, 700).links}
    inner = {(i, i + step) for step in (1, 2) for i in range(20 - step)}
    assert inner <= links
    # Only photos at the ends have room for others: they have two neighbours, not four.
    assert all(first < 2 or second > 17 for first, second in links - inner)
    assert all(sum(photo in link for link in links) >= LINKS for photo in range(20))


def test_a_model_is_made_of_more_pairs():
    evidence = walk(20, 700)
    few, many = ({(one.first, one.second) for one in evidence.strongest(n)} for n in (4, 8))
    assert few < many < {(one.first, one.second) for one in evidence.pairs}
    assert all(sum(photo in link for link in many) >= 8 for photo in range(20))


def test_inlier_ratio_of_a_photo():
    links = [pair(1, 2, 100), pair(1, 3, 300), pair(2, 4, 50)]
    explained = Explained(links, np.array([100, 300, 50]), np.array([80, 300, -1]))
    assert explained.inlier_ratios() == {1: 0.95, 2: 0.8, 3: 1.0}
    assert explained.total == 380


def test_matches_that_stand_still():
    place = np.array([[10.0, 10.0], [50.0, 20.0], [90.0, 30.0], [15.0, 70.0]])
    moves = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.5], [40.0, 0.0]])
    keypoints = {1: place, 2: place + moves}
    same = np.repeat(np.arange(4, dtype=np.uint32)[:, None], 2, axis=1)
    assert Evidence([MatchedPair(1, 2, same)], keypoints).still == 0.75
    assert Evidence([], keypoints).still == 0.0
