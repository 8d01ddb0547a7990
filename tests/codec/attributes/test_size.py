"""Sizes of attributes on real and generated data, against the published coder's bytes."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.codec import row_coder
from clgs.lab.bench.codec import PUBLISHED_ATTRIBUTES as BASELINE

LIMIT = {  # ratios to the baseline, default level
    "iid_offset": 0.985,
    "iid_feat": 0.985,
    "iid_scale": 0.985,
    "chan_feat": 0.963,
    "zi_offset": 0.985,
    "corr_weak": 0.970,
    "corr_scale": 0.955,
    "biker_scale_q8": 0.890,
    "biker_color": 0.520,
}


def load(name: str, folder) -> np.ndarray:
    return np.load(folder / "codec" / f"{name}.npz")["values"].astype(np.int32)


def size(value: np.ndarray, level: str, chunk: int = row_coder.CHUNK) -> int:
    model = row_coder.fit(value, level, chunk)
    parts = [value[first : first + chunk] for first in range(0, len(value), chunk)]
    return len(model.header) + sum(len(model.encode(part)) for part in parts)


@pytest.mark.slow
@pytest.mark.parametrize("name", BASELINE)
def test_default(name, shared_data):
    assert size(load(name, shared_data), "default") <= LIMIT[name] * BASELINE[name]


MAX_LIMIT = {"corr_weak": 0.96, "corr_scale": 0.95, "biker_scale_q8": 0.87, "biker_color": 0.48}


@pytest.mark.slow
@pytest.mark.parametrize("name", BASELINE)
def test_max(name, shared_data):
    value = load(name, shared_data)
    limit = MAX_LIMIT.get(name, LIMIT[name])
    assert size(value, "max") <= min(limit * BASELINE[name], size(value, "default"))


@pytest.mark.slow
def test_geometric_mean_of_default(shared_data):
    ratios = [size(load(n, shared_data), "default") / b for n, b in BASELINE.items()]
    assert np.exp(np.log(ratios).mean()) <= 0.90
    assert max(ratios) <= 1


def test_scales_that_change_from_row_to_row_take_no_more_than_the_plain_coder(rng):
    """More values than are compared by encoding at any rate, unlike their sample."""
    scale = np.exp(3 * np.sin(np.arange(100_000) / 700))[:, None]
    waves = np.rint(rng.normal(size=(100_000, 4)) * scale)
    halves = np.concatenate([np.zeros((50_000, 3)), np.rint(rng.laplace(0, 3, (50_000, 3)))])
    for value in (waves.astype(np.int32), halves.astype(np.int32)):
        assert size(value, "max") <= size(value, "default") <= size(value, "paper")


@pytest.mark.parametrize("level", ["fast", "default"])
@pytest.mark.parametrize(("spread", "bound"), [(0.5, 1.003), (2.0, 1.003), (12.0, 1.005)])
def test_laplace_integers_cost_their_entropy(spread, level, bound):
    """Entropy of what was drawn (20,000 rows of 20 channels), and a table per channel."""
    value = np.rint(np.random.default_rng(5).laplace(0, spread, (20_000, 20))).astype(np.int32)
    entropy = 0.0
    for column in value.T:
        share = np.unique(column, return_counts=True)[1] / len(column)
        entropy -= (share * np.log2(share)).sum() * len(column) / 8
    assert size(value, level) <= bound * entropy


def test_small_chunks_cost_little():
    """Against one chunk of all 32,768 rows of 50 channels at 2.4 bits."""
    value = np.rint(np.random.default_rng(6).laplace(0, 0.95, (32768, 50))).astype(np.int32)
    whole = size(value, "default", len(value))
    for chunk, bound in ((1024, 1.04), (16384, 1.004)):
        assert size(value, "default", chunk) <= bound * whole
