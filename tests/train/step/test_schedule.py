from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgs.train.config import LearningRates, TrainConfig, preset
from clgs.train.step.grow_and_prune import replaces_anchors
from clgs.train.step.schedule import learning_rates, log_linear


def test_rates_at_start_middle_and_end():
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


def test_a_batch_multiplies_rates_by_its_root():
    alone = learning_rates(TrainConfig(), 700, 3.0)
    of_four = learning_rates(TrainConfig(batch=4), 700, 3.0)
    exposure = alone.pop("exposure")  # each photo's own, which one view of the batch moves
    assert of_four.pop("exposure") == exposure
    assert of_four == pytest.approx({name: 2 * rate for name, rate in alone.items()})


def test_growth_keeps_its_pace_by_views():
    for batch, interval in ((1, 100), (3, 33), (128, 1)):
        config = TrainConfig(batch=batch)
        found = [step for step in range(2000, 2400) if replaces_anchors(config, step)]
        assert found == [step for step in range(2000, 2400) if step % interval == 0]


def test_constant_groups_stay_exactly_constant():
    config = preset("paper")
    for step in (1, 777, 29_999):
        rates = learning_rates(config, step, 2.0)
        assert (rates["feature"], rates["scaling"], rates["mlp_covariance"]) == (
            *(0.0075, 0.007, 0.004),
        )


def test_horizon_scales_with_steps():
    full, short = TrainConfig(), TrainConfig().scaled(3000)
    at_a_third, short_third = learning_rates(full, 10_000, 1.0), learning_rates(short, 1_000, 1.0)
    grown = {"feature": 10**0.5, "offset": 10**0.25, "exposure": 10**0.5}
    wanted = {name: rate * grown.get(name, 1.0) for name, rate in at_a_third.items()}
    assert short_third == pytest.approx(wanted)


@given(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0), st.floats(0.0, 1.0))
def test_log_linear_is_linear_in_the_logarithm(first, last, progress):
    expected = (1 - progress) * np.log(first) + progress * np.log(last)
    assert np.log(log_linear(first, last, progress)) == pytest.approx(expected, abs=1e-9)


def test_rising_rates_are_allowed():
    config = TrainConfig(learning_rates=LearningRates(feature=(0.001, 0.1)))
    assert learning_rates(config, 15_000, 1.0)["feature"] == pytest.approx(0.01)
