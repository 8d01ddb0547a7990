"""Sizes on real and generated data, against the bytes that the published coders need."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.codec import octree

POSITIONS = {  # bytes of tmc13 v23, lossless octree geometry
    "scene_q200": 484946,
    "armadillo_sparse_1024": 51899,
    "armadillo_dense_1024": 242340,
    "bunny_4096": 464382,
    "bunny_noisy_2048": 534403,
    "biker_1628": 160897,
    "biker_407": 49801,
}
QUICK = {"armadillo_sparse_1024", "biker_407"}
LIMIT = {"bunny_4096": 1.01}
"""Ratios to the baseline that are kept, where they are not 1; 1.10 is asked of all."""


def marked(baselines: dict[str, int]) -> list:
    return [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in baselines]


@pytest.mark.parametrize("name", marked(POSITIONS))
def test_positions(name, shared_data):
    position = np.load(shared_data / "codec" / f"{name}.npz")["positions"].astype(np.int32)
    position = position[octree.morton_order(position)]
    data = octree.encode(position)
    np.testing.assert_array_equal(octree.decode(data, len(position)), position)
    assert len(data) <= LIMIT.get(name, 1.0) * POSITIONS[name]


def test_scattered_points_cost_their_entropy():
    """Within 3 % of log2 of the number of sets of 30,000 cells out of 2^30, a point."""
    position = np.random.default_rng(6).integers(0, 1024, (30_000, 3)).astype(np.int32)
    position = np.unique(position, axis=0).astype(np.int32)
    position = position[octree.morton_order(position)]
    count = len(position)
    bits = count * (30 + np.log2(np.e)) - count * np.log2(count)
    assert 8 * len(octree.encode(position)) <= 1.03 * bits
