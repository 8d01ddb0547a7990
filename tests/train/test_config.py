from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgs.errors import DataError, UsageError
from clgs.train.config import LearningRates, TrainConfig, from_toml, options_of, preset
from clgs.train.config.option import at_least, option
from clgs.train.state.checkpoint import changed_settings


def test_the_paper_is_the_published_one():
    config = preset("paper")
    assert (config.steps, config.switch_step) == (30_000, 15_000)
    assert (config.l1_weight, config.ssim_weight, config.rate_weight) == (0.8, 0.2, 1e-4)
    assert (config.statistics_start, config.growth_start, config.growth_end) == (500, 1500, 15000)
    assert (config.slot_seen, config.anchor_visits) == (100 * 0.8 * 0.5, 100 * 0.8)
    assert (config.growth_interval, config.growth_levels, config.growth_cell) == (100, 3, 4)
    assert (config.growth_threshold, config.prune_opacity) == (2e-4, 0.005)
    assert (config.offset_q, config.feature_q, config.scaling_q) == (1.0, 1.0, 8.0)
    assert (config.background, config.near, config.scaling_cap) == ("black", 0.2, 0.05)
    assert (config.start_points, config.start_volume) == (100_000, "cube")
    assert (config.mlp, config.proxy, config.normalize) == ("float32", "pooled", False)
    assert (config.size_lambda, config.target_size, config.freeze_step) == (0.0, 0, 30_000)
    rates = config.learning_rates
    assert (rates.offset, rates.mlp_opacity) == ((0.01, 0.0001), (0.002, 2e-5))
    assert (rates.feature, rates.scaling) == ((0.0075, 0.0075), (0.007, 0.007))
    assert (rates.mlp_covariance, rates.mlp_color) == ((0.004, 0.004), (0.008, 5e-5))


@pytest.mark.parametrize(
    ("name", "kind", "voxel", "position_q", "volume_weight"),
    [
        ("default", "blender", 0.001, 1000.0, 0.0),
        ("default", "colmap", 0.005, 200.0, 0.01),
        ("default", "transforms", 0.005, 200.0, 0.01),
        ("paper", "blender", 0.001, 1024.0, 0.0),
        ("paper", "colmap", 0.005, 200.0, 0.01),
    ],
)
def test_open_settings_follow_the_dataset(name, kind, voxel, position_q, volume_weight):
    config = preset(name).for_dataset(kind)
    assert (config.voxel, config.position_q) == (voxel, position_q)
    assert config.volume_weight == volume_weight
    assert config.for_dataset(kind) == config


def test_a_batch_has_the_lambda_of_as_many_views():
    for steps, batch in ((300, 2), (3_000, 4)):
        some = TrainConfig(batch=batch).scaled(steps).for_dataset("colmap")
        alone = TrainConfig().scaled(steps * batch).for_dataset("colmap")
        assert some.size_lambda == alone.size_lambda
        grown = TrainConfig().scaled(steps).for_devices(batch).for_dataset("colmap")
        assert grown.size_lambda == some.size_lambda


@pytest.mark.parametrize(
    ("kind", "values", "threshold"),
    [
        ("blender", {}, 2e-4),
        ("colmap", {"size_lambda": 0.9 * 10**0.7 * 4}, 2e-4),
        ("colmap", {"size_lambda": 0.9 * 10**0.7 / 4}, 2e-4),
        ("blender", {"size_lambda": 0.33 * 10**0.7 / 4}, 1e-4),
        ("blender", {"size_lambda": 0.33 * 10**0.7 / 2}, 2e-4 / 2**0.5),
        ("blender", {"size_lambda": 1e-9}, 1e-4),
        ("blender", {"size_lambda": 0.0}, 2e-4),
        ("blender", {"growth_threshold": 0.0}, 0.0),
        ("blender", {"target_size": 100_000}, None),
        ("colmap", {"target_size": 100_000}, 2e-4),
        ("blender", {"target_size": 100_000, "growth_threshold": 0.0}, 0.0),
        ("blender", {"target_size": 100_000, "growth_threshold": 3e-4}, 3e-4),
        ("colmap", {"size_lambda": 1e-9, "growth_threshold": 3e-4}, 3e-4),
    ],
)
def test_the_growth_threshold_follows_the_price(kind, values, threshold):
    config = TrainConfig(**values).for_dataset(kind)
    assert config.growth_threshold == pytest.approx(threshold)
    assert config.for_dataset(kind) == config


def test_given_settings_win_over_the_dataset():
    config = TrainConfig(voxel=0.01, volume_weight=0.0).for_dataset("colmap")
    assert (config.voxel, config.position_q, config.volume_weight) == (0.01, 100.0, 0.0)
    assert TrainConfig(position_q=256).for_dataset("blender").position_q == 256.0


def test_scaled_moves_moments_and_keeps_intervals():
    full, short = TrainConfig(), TrainConfig().scaled(3000)
    moved = {
        "steps": 3000,
        "statistics_start": 50,
        "growth_start": 150,
        "growth_end": 1500,
        "switch_step": 1500,
        "prune_end": 2250,
        "freeze_step": 2850,
        "mlp_switch_step": 2400,
        "learning_rate_steps": 3000,
    }
    rates = short.learning_rates
    assert dataclasses.replace(short, learning_rates=full.learning_rates) == dataclasses.replace(
        full, **moved
    )
    grown = {"feature": 0.5, "offset": 0.25, "exposure": 0.5}
    for one in dataclasses.fields(rates):
        before = getattr(full.learning_rates, one.name)
        wanted = [10 ** grown.get(one.name, 0.0) * rate for rate in before]
        assert getattr(rates, one.name) == pytest.approx(wanted)
    assert (short.growth_interval, short.rate_interval) == (100, 10)
    assert (short.slot_seen, short.anchor_visits) == (40, 80)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"target_size": 12_999},
            "target_size: 12999 is out of range; give a whole number, 0 or",
        ),
        ({"target_size": 40_000, "mlp": "float32"}, "give at least 50000"),
        ({"start_points": 3}, "start_points: 3 is out of range; give a whole number, 0 or from"),
        (
            {"max_anchors": 3},
            "max_anchors: 3 is out of range; give a whole number, 0 or at",
        ),
    ],
)
def test_what_cannot_be_met_is_refused(values, message):
    with pytest.raises(UsageError, match=message):
        TrainConfig(**values)


def test_scaling_twice_is_scaling_once():
    once, twice = TrainConfig().scaled(900), TrainConfig().scaled(3000).scaled(900)
    for one in dataclasses.fields(LearningRates):
        name = one.name
        assert getattr(twice.learning_rates, name) == pytest.approx(
            getattr(once.learning_rates, name)
        )
    assert dataclasses.replace(twice, learning_rates=once.learning_rates) == once


def test_scaled_rounds_to_the_nearest_step():
    short = TrainConfig().scaled(777)  # 12.95, 38.85, 388.5
    assert (short.statistics_start, short.growth_start, short.switch_step) == (13, 39, 389)


@given(st.integers(1, 200_000))
def test_any_number_of_steps_gives_a_valid_run(steps):
    config = TrainConfig().scaled(steps)
    assert config.steps == steps
    assert config.statistics_start <= config.growth_start <= config.growth_end
    assert config.growth_end <= config.switch_step <= config.freeze_step <= steps
    assert config.learning_rate_steps == steps


def test_presets():
    assert preset("quick") == dataclasses.replace(TrainConfig().scaled(3000), preset="quick")
    with pytest.raises(UsageError, match="default, quick or paper"):
        preset("best")


@pytest.mark.parametrize(
    "config",
    [
        TrainConfig(),
        preset("paper").for_dataset("blender"),
        TrainConfig(seed=2**40, learning_rates=LearningRates(offset=(0.1, 0.3))).scaled(777),
    ],
)
def test_toml_round_trip(config):
    text = config.to_toml()
    assert from_toml(text) == config
    assert from_toml(text).to_toml() == text
    assert from_toml(text).digest() == config.digest()
    names = {field.name for field in dataclasses.fields(config)}
    assert names - set(tomllib.loads(text)) <= {"volume_weight", "size_lambda", "growth_threshold"}


def test_digest_tells_settings_apart_but_not_spellings():
    assert TrainConfig(seed=1).digest() != TrainConfig().digest()
    assert TrainConfig(near=1).digest() == TrainConfig(near=1.0).digest()


FIRST_OPTIONS = 64
"""Options that all runs have had."""


@dataclass(frozen=True)
class Newer(TrainConfig):
    more: int = option(0, "a setting that came later", at_least(0), unit="none", later=True)


@dataclass(frozen=True)
class Other(TrainConfig):
    more: int = option(3, "came later", at_least(0), unit="none", later=True, before=1)


def test_runs_from_before_a_setting_that_changed_the_default_keep_their_digest():
    assert Other(more=1).digest() == TrainConfig().digest()
    assert Other().digest() != TrainConfig().digest()
    written = TrainConfig().to_toml()
    older = "".join(line for line in written.splitlines(True) if "start_fill" not in line)
    assert len(older) < len(written)
    assert from_toml(written).start_fill == 3.0
    assert from_toml(older).start_fill == 1.0


def test_what_differs_from_an_older_run_can_be_given(tmp_path):
    text = TrainConfig(start_fill=1.0).to_toml().replace("start_fill = 1.0\n", "")
    (tmp_path / "config.toml").write_text(text)
    assert changed_settings(tmp_path, TrainConfig()) == " (--start-fill: 1.0 there, 3.0 here)"
    assert changed_settings(tmp_path, TrainConfig(start_fill=1.0)) == ""


def test_runs_from_before_a_setting_keep_their_digest():
    assert Newer().digest() == TrainConfig().digest()
    assert Newer(more=1).digest() != TrainConfig().digest()
    later = "masks", "test_every", "fisheye_view", "batch", "average"
    assert all(options_of(TrainConfig)[name].later for name in later)
    first = sum(not one.later for one in options_of(TrainConfig).values())
    assert first == FIRST_OPTIONS, "declare a new option with later=True: older runs lack it"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stepz = 3", "stepz: no such setting; did you mean steps?"),
        ("[learning_rates]\nposition = [1.0, 1.0]", "learning_rates.position: no such setting"),
        ("learning_rates = 3", "learning_rates: is not a table"),
        ("[learning_rates]\noffset = 0.1", "learning_rates.offset"),
        ("[learning_rates]\noffset = [0.1, 0.0]", "learning_rates.offset"),
        ("steps = 3.5", "steps: 3.5 is not a whole number"),
        ("steps = true", "steps: True is not a whole number"),
        ("normalize = 1", "normalize: 1 is not true or false"),
        ("near = nan", "near: nan is not a finite number"),
        ("near = 'close'", "near: 'close' is not a finite number"),
        ("l1_weight = -0.1", "l1_weight: -0.1 is out of range; give a number from 0 to"),
        ("offset_q = -1", "offset_q: -1 is out of range; give a number of at least 0"),
        ("background = 'grey'", "black, white or random"),
        ("background = 7", "black, white or random"),
        ("proxy = ['channel']", "channel or pooled"),
        ("growth_start = 16000", "growth_start: 16000 is after growth_end 15000"),
        (f"near = 1{'0' * 400}", "near: 1000"),
        (f"seed = {2**63}", "seed: 9223372036854775808 is out of range"),
        ("growth_end = 20000", "growth_end: 20000 is after switch_step 15000"),
        ("steps = ", "not a TOML file"),
    ],
)
def test_bad_files_are_refused_with_one_line(text, message):
    with pytest.raises(DataError) as caught:
        from_toml(text, "run/config.toml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("run/config.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [0, 0.3, 0.8])
def test_a_run_s_file_that_was_cut_short_is_refused(kept):
    lines = preset("quick").to_toml().splitlines()
    rest = "\n".join(lines[: int(kept * lines.index("[learning_rates]"))])
    with pytest.raises(DataError, match=r"^config.toml: has no .*, as if cut short; restore it"):
        from_toml(rest)


def test_bad_values_in_code_are_usage_errors():
    with pytest.raises(UsageError) as caught:
        TrainConfig(growth_interval=0)
    assert caught.value.exit_code == 2
    with pytest.raises(UsageError, match="steps: 0"):
        TrainConfig().scaled(0)
    assert TrainConfig(scaling_cap=-1).scaling_cap == -1.0


@pytest.mark.parametrize("name", ["l1_weight", "ssim_weight", "volume_weight", "rate_weight"])
def test_weights_have_a_bound_that_is_said(name):
    assert getattr(TrainConfig(**{name: 1e6}), name) == 1e6
    with pytest.raises(
        UsageError, match=rf"{name}: 1e\+30 is out of range; give a number from 0 to 1e\+06"
    ):
        TrainConfig(**{name: 1e30})


def test_a_loss_without_weights_is_refused():
    assert TrainConfig(l1_weight=0).ssim_weight > 0
    assert TrainConfig(ssim_weight=0).l1_weight > 0
    with pytest.raises(UsageError, match="both are 0"):
        TrainConfig(l1_weight=0, ssim_weight=0)


def test_what_is_logged_and_saved_when_is_no_part_of_the_digest():
    config = TrainConfig()
    assert replace(config, checkpoint_interval=9, log_interval=7).digest() == config.digest()
    assert replace(config, growth_interval=9).digest() != config.digest()
