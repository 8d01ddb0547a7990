"""Which pairs of photos speak for or against a model, and differences of two reconstructions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clgs.poses.evidence import LINKS, Evidence, Explained, MatchedPair, Poses, angle, differences


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


def poses(count: int, seed: int = 0) -> Poses:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(count, random_state=seed).as_matrix()
    names = [f"{number:03d}" for number in range(count)]
    return Poses(names, rotation, rng.normal(size=(count, 3)), np.full(count, 5.0))


def moved(some: Poses) -> Poses:
    """The same photos in a world that is turned, three times as large, and elsewhere."""
    turn = Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    centre = 3.0 * some.centre @ turn.T + [1.0, 2.0, 3.0]
    return Poses(some.names, some.rotation @ turn.T, centre, 3.0 * some.depth)


def test_a_similarity_is_no_difference():
    found = differences(poses(12), moved(poses(12)))
    assert list(found) == poses(12).names
    # Rounding of float64, and no more; degrees.
    assert max(one.turn for one in found.values()) <= 1e-6
    assert max(one.shift for one in found.values()) <= 1e-6


def test_those_that_moved_are_found():
    first, second = poses(12), moved(poses(12))
    tipped = Rotation.from_rotvec([0.0, 0.0, np.radians(80.0)]).as_matrix()
    for place in (2, 7, 8):
        second.rotation[place] = tipped @ second.rotation[place]
    second.centre[4] += [0.0, 0.0, 15.0]
    found = differences(first, second)
    turned = {name: one.turn for name, one in found.items() if one.turn > 1e-6}
    assert turned == {name: pytest.approx(80.0) for name in ("002", "007", "008")}
    shifted = {name: one.shift for name, one in found.items() if one.shift > 1e-6}
    assert shifted == {"004": pytest.approx(45.0)}  # as far as its points are


def test_only_common_photos_are_compared():
    first, second = poses(6), moved(poses(6))
    assert list(differences(first, second.chosen(["001", "003", "004"]))) == ["001", "003", "004"]
    assert differences(first, second.chosen(["001"])) == {}


@pytest.mark.parametrize("degrees", [0.0, 1e-5, 1.0, 90.0, 179.9])
def test_small_and_large_angles(degrees: float):
    found = angle(Rotation.from_rotvec([0.0, np.radians(degrees), 0.0]).as_matrix())
    assert float(found) == pytest.approx(degrees, abs=1e-9)
