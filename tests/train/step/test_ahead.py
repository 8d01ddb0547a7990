"""A trainer that runs ahead of its results ends where one that waits does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.render.frame import Room
from clgs.train.config import preset
from clgs.train.run.trainer import NonFiniteLossError, Trainer
from clgs.train.step import look
from tests.train.state.test_run_state import arrays_of

STEPS = 240


def trainer(device, dataset, ahead):
    config = replace(preset("default").scaled(STEPS), voxel=0.02, background="random")
    return Trainer(device, dataset, config.for_dataset(dataset.kind), ahead)


@pytest.mark.slow
@pytest.mark.parametrize("specialisation", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def test_steps_that_lack_room_are_repeated(dataset, open_device, specialisation):
    device, count = open_device(specialisation), 130
    if specialisation == "gpu":  # slow where the device is a CPU
        count, dataset = 30, replace(dataset, points=dataset.points[::8])
    waiting, ahead = (trainer(device, dataset, mode) for mode in (False, True))
    wanted = list(waiting.steps(count))
    repeats, clear = [], ahead.queue.clear
    ahead.queue.clear = lambda: (repeats.append(ahead.steps_done), clear())  # before a repeat
    results = []
    for result in ahead.steps(count):
        results.append(result)
        if result.step % 23 == 0:
            ahead.queue.room = Room(8, 8, 8)
    assert len(repeats) >= count // 23
    assert results == wanted
    assert arrays_of(device, ahead.state) == arrays_of(device, waiting.state)
    assert ahead.state.rng.bit_generator.state == waiting.state.rng.bit_generator.state


@pytest.mark.slow
def test_stopping_finishes_what_began(dataset, cpu):
    waiting, ahead = (trainer(cpu, dataset, mode) for mode in (False, True))
    seen = []
    for result in ahead.steps(50, stop=lambda: len(seen) >= 20):
        seen.append(result.step)
    assert seen == list(range(1, ahead.steps_done + 1))
    assert 20 <= len(seen) <= 22
    assert [result.step for result in waiting.steps(len(seen))] == seen
    assert arrays_of(cpu, ahead.state) == arrays_of(cpu, waiting.state)


def test_numbers_that_are_not_finite_stop_the_right_step(dataset, cpu):
    ends = []
    for mode in (False, True):
        one = trainer(cpu, dataset, mode)
        list(one.steps(6))
        weights = cpu.download(one.parameters.scene.weights)
        weights[4000] = np.nan  # a weight of the colour MLP
        cpu.write(one.parameters.scene.weights, weights)
        before = arrays_of(cpu, one.state)
        with pytest.raises(NonFiniteLossError, match=r"at step 7, view \S*r_\d+"):
            list(one.steps(10))
        assert one.steps_done == 6
        assert arrays_of(cpu, one.state) == before
        ends.append(before)
    assert ends[0] == ends[1]


def test_a_gradient_that_is_not_finite_is_named(dataset, cpu, monkeypatch):
    one = trainer(cpu, dataset, True)
    list(one.steps(3))
    before = arrays_of(cpu, one.state)
    backward = look.rasterise_backward

    def broken(*arguments):
        gradients = backward(*arguments)
        cpu.write(gradients.d_scaling, np.full(gradients.d_scaling.shape, np.inf, np.float32))
        return gradients

    monkeypatch.setattr(look, "rasterise_backward", broken)
    with pytest.raises(NonFiniteLossError, match="a gradient is not finite at step 4, view"):
        list(one.steps(5))
    assert arrays_of(cpu, one.state) == before
