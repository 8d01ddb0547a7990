"""Cameras apart from the rest, and those that only walked away."""

from __future__ import annotations

import numpy as np

from clgs.data.complaints import lonely


def cluster(rng: np.random.Generator, count: int = 20) -> np.ndarray:
    return rng.normal(size=(count, 3))


def test_a_camera_far_from_all_others_is_lonely(rng):
    found = lonely(np.vstack([cluster(rng), [[12.0, 0.0, 0.0]]]))
    assert found[-1]
    assert not found[:-1].any()


def test_who_walks_away_is_not(rng):
    walk = np.linspace([0.0, 0.0, 0.0], [15.0, 0.0, 0.0], 9)[1:]
    assert not lonely(np.vstack([cluster(rng), walk])).any()


def test_several_that_no_capture_has_are(rng):
    found = lonely(np.vstack([cluster(rng), [[90.0, 0.0, 0.0], [91.0, 0.0, 0.0]]]))
    assert found[-2:].all()
    assert not found[:-2].any()


def test_few_cameras_say_nothing(rng):
    assert not lonely(np.vstack([cluster(rng, 3), [[90.0, 0.0, 0.0]]])).any()
