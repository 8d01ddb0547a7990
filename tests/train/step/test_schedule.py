from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgs.train.config import LearningRates, TrainConfig
from clgs.train.step.schedule import ViewSampler, learning_rates, log_linear, restore_rng


def test_rates_at_start_middle_and_end() -> None:
    config, radius = TrainConfig(), 4.0
    start = learning_rates(config, 0, radius)
    assert start == pytest.approx(
        {
            "offset": 0.04,
            "feature": 0.0075,
            "scaling": 0.007,
            "mlp_opacity": 0.002,
            "mlp_covariance": 0.004,
            "mlp_color": 0.008,
            "exposure": 0.01,
        }
    )
    middle = learning_rates(config, 15_000, radius)
    assert middle["offset"] == pytest.approx(0.004)  # the geometric mean of 0.04 and 0.0004
    assert middle["mlp_opacity"] == pytest.approx(2e-4)
    assert middle["mlp_color"] == pytest.approx((0.008 * 5e-5) ** 0.5)
    end = learning_rates(config, 30_000, radius)
    assert end["offset"] == pytest.approx(4e-4)
    assert end["mlp_color"] == pytest.approx(5e-5)
    assert learning_rates(config, 40_000, radius) == end


def test_constant_groups_stay_exactly_constant() -> None:
    config = TrainConfig()
    for step in (1, 777, 29_999):
        rates = learning_rates(config, step, 2.0)
        assert (rates["feature"], rates["scaling"], rates["mlp_covariance"]) == (
            *(0.0075, 0.007, 0.004),
        )


def test_horizon_scales_with_steps() -> None:
    full, short = TrainConfig(), TrainConfig().scaled(3000)
    at_a_third, short_third = learning_rates(full, 10_000, 1.0), learning_rates(short, 1_000, 1.0)
    # between the powers at the start and at the end of a run of a tenth
    grown = {"feature": 10 ** (0.75 - 1.0 / 3), "offset": 10 ** (0.5 - 0.25 / 3)}
    grown["exposure"] = 10**0.5
    for name, rate in at_a_third.items():
        assert short_third[name] == pytest.approx(rate * grown.get(name, 1.0))


@given(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0), st.floats(0.0, 1.0))
def test_log_linear_is_linear_in_the_logarithm(first: float, last: float, progress: float) -> None:
    expected = (1 - progress) * np.log(first) + progress * np.log(last)
    assert np.log(log_linear(first, last, progress)) == pytest.approx(expected, abs=1e-9)


def test_rising_rates_are_allowed() -> None:
    config = TrainConfig(learning_rates=LearningRates(feature=(0.001, 0.1)))
    assert learning_rates(config, 15_000, 1.0)["feature"] == pytest.approx(0.01)


def test_every_view_once_an_epoch_in_changing_order() -> None:
    sampler = ViewSampler(20, 3)
    epochs = [[sampler.next() for _ in range(20)] for _ in range(5)]
    for epoch in epochs:
        assert Counter(epoch) == Counter(range(20))
    assert len({tuple(epoch) for epoch in epochs}) == 5


def test_order_depends_on_the_seed_alone() -> None:
    def deal(seed: int) -> list[int]:
        sampler = ViewSampler(30, seed)
        return [sampler.next() for _ in range(60)]

    assert deal(1) == deal(1)
    assert deal(1) != deal(2)


@pytest.mark.parametrize("taken", [0, 1, 6, 7, 8, 20])
def test_restored_sampler_continues_exactly(taken: int) -> None:
    sampler = ViewSampler(7, 5)
    for _ in range(taken):
        sampler.next()
    restored = ViewSampler.restore(json.loads(json.dumps(sampler.state())))
    assert [restored.next() for _ in range(30)] == [sampler.next() for _ in range(30)]


def test_state_is_a_copy() -> None:
    sampler = ViewSampler(4, 0)
    sampler.next()
    state = sampler.state()
    before = json.dumps(state)
    for _ in range(9):
        sampler.next()
    assert json.dumps(state) == before


def test_no_views_is_an_error() -> None:
    with pytest.raises(ValueError, match="no view"):
        ViewSampler(0, 0)


def test_restored_rng_continues_exactly() -> None:
    rng = np.random.default_rng(9)
    rng.random(5)
    rng.integers(0, 7, 3, dtype=np.int32)  # leaves half a 64-bit draw in the state
    restored = restore_rng(json.loads(json.dumps(rng.bit_generator.state)))
    assert restored.integers(0, 1 << 20, 9, dtype=np.int32).tolist() == (
        rng.integers(0, 1 << 20, 9, dtype=np.int32).tolist()
    )
    assert restored.random(9).tolist() == rng.random(9).tolist()
