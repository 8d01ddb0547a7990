"""Which photos of a large set are matched."""

import numpy as np

from clgs.poses.stages.pairs import LOOK_ALIKES, OVERLAP, likely_pairs


def photos(count: int, places: int, seed: int = 0) -> list[np.ndarray]:
    """Descriptors of a walk that passes each of ``places`` again and again."""
    rng = np.random.default_rng(seed)
    scenes = rng.integers(0, 256, (places, 150, 128))
    noise = rng.integers(-12, 13, (count, 150, 128))
    walk = [scenes[i % places] + noise[i] for i in range(count)]
    return [np.clip(some, 0, 255).astype(np.uint8) for some in walk]


def test_neighbours_by_name_are_pairs():
    pairs = likely_pairs(photos(60, 60), 0)
    assert set(pairs) >= {(i, i + k) for k in range(1, OVERLAP + 1) for i in range(60 - k)}
    assert set(pairs) >= {(i, i + 32) for i in range(28)}
    assert all(i < j for i, j in pairs)
    assert len(pairs) < 60 * 59 // 2


def test_loops_are_closed_by_likeness():
    places = 31  # met again after 31 photos, which is no power of two
    pairs = set(likely_pairs(photos(124, places), 0))
    assert 124 // places <= LOOK_ALIKES
    assert {(i, i + places) for i in range(124 - places)} <= pairs


def test_the_seed_decides():
    some = photos(40, 40)
    assert likely_pairs(some, 3) == likely_pairs(some, 3)


def test_photos_without_features_have_neighbours_still():
    some = [*photos(12, 12), np.empty((0, 128), np.uint8)]
    assert (11, 12) in likely_pairs(some, 0)
