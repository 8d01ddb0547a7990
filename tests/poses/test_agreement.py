"""Differences of two reconstructions, made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clgs.poses.evidence import Poses, angle, differences


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
