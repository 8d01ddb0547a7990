"""Rounds of a run: what lambda leaves, sizes that are met, anchors that are not exceeded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_encoder import encode
from clgs.train.config import TrainConfig, preset
from clgs.train.config.settings import FINE_Q
from clgs.train.rate import economy
from clgs.train.rate.economy import (
    ANCHOR_BITS,
    LEAST_ROUNDS,
    MOST_DEARER,
    ROUNDS,
    THINNED,
    Economy,
)
from clgs.train.rate.pricing import MOST, compare
from clgs.train.run.session import train_scene
from clgs.train.run.trainer import Trainer
from clgs.train.state.rounding import Rounding, rounded_anchors

STEPS = 120


def config(dataset, **changes):
    settings = replace(preset("default").scaled(STEPS), **{"voxel": 0.02, **changes})
    return settings.for_dataset(dataset.kind)


def trained(cpu, dataset, **changes) -> Trainer:
    trainer = Trainer(cpu, dataset, config(dataset, **changes))
    list(trainer.steps(STEPS))
    return trainer


@pytest.fixture(scope="module")
def untouched(open_device, dataset):
    """A run in which nothing is left out."""
    return trained(open_device("cpu"), dataset, size_lambda=0.0)


def test_without_lambda_there_are_no_rounds(untouched):
    assert untouched.rounds == []
    scales = untouched.state.rate.scales
    found = {f"{name}_q": getattr(scales, name) for name in ("offset", "feature", "scaling")}
    assert found == FINE_Q


@pytest.mark.slow
def test_without_lambda_pictures_are_not_worse(cpu, dataset, untouched):
    """Once they were: anchors were rounded as in the paper, far coarser than any price chose."""
    priced = trained(cpu, dataset, size_lambda=0.05)
    assert untouched.psnr(dataset.train) > priced.psnr(dataset.train) - 0.1


@pytest.mark.slow
def test_lambda_trades_size_for_quality(cpu, dataset, untouched):
    """The second lambda is the largest one that may be asked for."""
    small, smaller = (trained(cpu, dataset, size_lambda=value) for value in (2.0, 1e6))
    assert smaller.parameters.count >= 1
    sizes = [len(encode(one.quantized_scene())) for one in (untouched, small, smaller)]
    assert sizes[0] > sizes[1] > sizes[2]
    assert small.psnr(dataset.train) > smaller.psnr(dataset.train)
    assert len(small.rounds) == len(THINNED) + LEAST_ROUNDS
    assert small.rounds[-1].after < small.rounds[0].before
    assert small.rounds[0].price < smaller.rounds[0].price
    early = [one for one in smaller.rounds if one.step < smaller.config.switch_step]
    assert [one.changed for one in early] == [0] * len(THINNED)
    assert all(0.7 * one.before <= one.after < one.before for one in early)
    gone = [1 - one.after / one.before for one in smaller.rounds if one not in early]
    assert MOST < max(gone) <= MOST_DEARER * MOST + 0.01  # whole anchors
    ended = [one for one in small.rounds if one.step > small.config.prune_end]
    assert ended
    assert all(one.before == one.after for one in ended)


@pytest.mark.slow
def test_a_single_view_is_judged_in_every_round(cpu, dataset):
    alone = replace(dataset, train=dataset.train[:1])
    trainer = trained(cpu, alone, size_lambda=1.0)
    assert len(trainer.rounds) == len(THINNED) + LEAST_ROUNDS


def first_round(cpu, dataset, most: float, monkeypatch) -> tuple[float, float]:
    """Its price, and the loss after it, if that may be ``most`` times that of finest integers."""
    monkeypatch.setattr(economy, "MOST_LOSS", most)
    trainer = Trainer(cpu, dataset, config(dataset))
    step = trainer.config.switch_step
    list(trainer.steps(step))
    trainer.align_positions()
    rounds, state = trainer.economy, trainer.state
    drawn = trainer.rounding.scene_at(state, step)
    done = rounds.round(state, step)
    rounded = rounded_anchors(cpu, state.parameters.scene.anchors, state.rate.scales)
    scene = replace(drawn, anchors=rounded)
    return done.price, compare(cpu, trainer.config, scene, rounds.views)[0]


@pytest.mark.slow
def test_the_first_round_loses_no_more_than_is_allowed(cpu, dataset, monkeypatch):
    price, whole = first_round(cpu, dataset, 10.0, monkeypatch)
    _, least = first_round(cpu, dataset, 0.0, monkeypatch)
    most = 0.5 * (1.0 + whole / least)
    assert most > 1.001
    lower, less = first_round(cpu, dataset, most, monkeypatch)
    assert lower < price
    assert less <= most * least


def test_long_runs_have_more_rounds(cpu, dataset):
    counts = [
        len(Economy(cpu, dataset, one, Rounding(cpu, one)).steps)
        for steps in (1, STEPS, 1_000, 30_000)
        for one in [preset("default").scaled(steps).for_dataset("colmap")]
    ]
    assert counts == [1, *(len(THINNED) + n for n in (LEAST_ROUNDS, 5, ROUNDS))]


@pytest.mark.slow
@pytest.mark.parametrize(("size", "begun"), [(0, 20), (0, 29), (0, 30), (30_000, 30)])
def test_what_has_grown_before_is_thinned_for_a_size_alone(cpu, dataset, size, begun):
    growth = {"growth_start": 0, "statistics_start": 0, "growth_end": 30}
    trainer = Trainer(cpu, dataset, config(dataset, target_size=size, **growth))
    trainer.state.step = trainer.state.begun = begun
    list(trainer.steps(trainer.config.switch_step - begun))
    assert [one.step for one in trainer.rounds] == trainer.economy.steps[: len(THINNED)]
    gone = [one.before - one.after for one in trainer.rounds]
    assert gone[0] > 0 if size or begun < 30 else not any(gone)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0, 30_000])
def test_in_a_box_its_least_anchors_go_before_the_switch_and_no_others(cpu, dataset, size):
    settings = config(dataset, box="-inf,-inf,-inf,0,inf,inf", target_size=size, size_lambda=9.0)
    trainer = Trainer(cpu, dataset, settings)

    def outside():
        position = cpu.download(trainer.parameters.scene.anchors.position)
        return position[~settings.learning_box.holds(position)]

    others = outside()
    list(trainer.steps(STEPS))
    assert [one.step for one in trainer.rounds] == [
        round(share * settings.switch_step) for share in THINNED
    ]
    assert all(one.after < one.before for one in trainer.rounds)
    np.testing.assert_array_equal(outside(), others)
    if size:
        assert min(one.after for one in trainer.rounds) >= settings.held_anchors


@pytest.mark.parametrize("size", [0, 20_000])
def test_training_repairs_what_rounds_do_unless_a_size_must_be_met(cpu, dataset, size):
    settings = config(dataset, target_size=size)
    last = Economy(cpu, dataset, settings, Rounding(cpu, settings)).steps[-1]
    assert last == settings.freeze_step if size else last <= settings.freeze_step - 18


@pytest.mark.slow
def test_anchors_rest_in_the_end(cpu, dataset):
    trainer = Trainer(cpu, dataset, config(dataset))
    list(trainer.steps(trainer.config.freeze_step + 1))
    feature, weights = (trainer.parameters.scene.anchors.feature, trainer.parameters.scene.weights)
    before, weights_before = cpu.download(feature), cpu.download(weights)
    trainer.step()
    np.testing.assert_array_equal(cpu.download(feature), before)
    assert not np.array_equal(cpu.download(weights), weights_before)


@pytest.mark.slow
def test_a_size_is_met_and_never_exceeded(cpu, dataset):
    """On few anchors: every size that is tried is that of a whole file."""
    few = {"voxel": 0.2}
    whole = len(encode(trained(cpu, dataset, size_lambda=0.0, **few).quantized_scene()))
    for share in (0.8, 0.6):
        target = int(share * whole)
        size = len(encode(trained(cpu, dataset, target_size=target, **few).quantized_scene()))
        assert 0.98 * target <= size <= target


@pytest.mark.slow
def test_a_size_bounds_the_anchors_and_thinning_leaves_as_many_as_it_holds(cpu, dataset):
    target = 40_000
    settings = config(dataset, target_size=target)
    held = 8 * (target - 12_000) / ANCHOR_BITS
    assert held <= settings.held_anchors < held + 1
    trainer = Trainer(cpu, dataset, settings)
    counts = [result.anchors for result in trainer.steps(settings.switch_step)]
    assert max(counts) <= 1.5 * held + 2
    assert trainer.rounds[0].after < trainer.rounds[0].before
    assert min(one.after for one in trainer.rounds) >= held


@pytest.mark.parametrize(
    ("steps", "values", "most"),
    [
        (3000, {}, 0),
        (3000, {"max_anchors": 900}, 900),
        (3000, {"target_size": 12_000 + 223_400}, 12_000),
        (3000, {"target_size": 12_000 + 223_400, "max_anchors": 900}, 900),
        (3000, {"target_size": 46_000 + 223_400, "mlp": "float32"}, 12_000),
        (3000, {"target_size": 14_000}, 108),
        (9, {"target_size": 14_000}, 0),
    ],
)
def test_most_anchors(steps, values, most):
    assert replace(TrainConfig().scaled(steps), **values).most_anchors == most


@pytest.mark.slow
def test_growth_stops_at_the_most_anchors(cpu, dataset, untouched):
    most = untouched.parameters.count - 100
    trainer = Trainer(cpu, dataset, config(dataset, max_anchors=most, size_lambda=0.0))
    counts = [trainer.step().anchors for _ in range(STEPS // 2 + 1)]
    assert max(counts) <= most


@pytest.fixture(scope="module")
def saved(open_device, dataset, tmp_path_factory):
    """The file of a whole run, and a checkpoint of each moment: its folder, and the steps done."""
    settings, folder = config(dataset), tmp_path_factory.mktemp("saved")
    switch = settings.switch_step
    moments = {
        "before anchors go": switch - 30,
        "before the first round": switch,
        "after it": switch + 1,
        "between tables": switch + 7,
        "among means": settings.freeze_step - 5,
    }
    whole, done = Trainer(open_device("cpu"), dataset, settings), 0
    for moment, step in moments.items():
        list(whole.steps(step - done))
        whole.save(folder / moment)
        assert bool(whole.state.means.tensors) == (moment == "among means")
        done = step
    list(whole.steps(STEPS - done))
    return encode(whole.quantized_scene()), folder, moments


@pytest.mark.slow
@pytest.mark.parametrize(
    "moment",
    ["before anchors go", "before the first round", "after it", "between tables", "among means"],
)
def test_resumes_to_the_bit(cpu, dataset, saved, moment):
    wanted, folder, moments = saved
    other = Trainer(cpu, dataset, config(dataset))
    other.resume(folder / moment)
    list(other.steps(STEPS - moments[moment]))
    assert encode(other.quantized_scene()) == wanted


@pytest.mark.slow
def test_runs_too_short_for_rounds_meet_the_size_too(cpu, dataset, tmp_path):
    settings = replace(preset("default").scaled(1), voxel=0.02, target_size=16_000)
    result = train_scene(dataset, tmp_path, settings, device=cpu)
    assert 0.98 * 16_000 <= len(result.bitstream) <= 16_000
