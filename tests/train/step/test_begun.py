"""A scene that goes on without its moments moves at first by its learning rates, as a new one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgs.train.config import preset
from clgs.train.run.load import state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.train.step.schedule import learning_rates
from tests.train.state.test_run_state import arrays_of

STEP = 100
"""The number of the step that the scene has done."""


def going_on(device, dataset, done=STEP):
    """A run after ``done`` steps of a scene, its settings, and that scene."""
    config = replace(preset("default").scaled(240), voxel=0.02).for_dataset(dataset.kind)
    first = Trainer(device, dataset, config)
    list(first.steps(5))
    scene = first.quantized_scene().dequantize()
    state = state_of_scene(device, dataset, config, scene, done)
    return Trainer(device, dataset, config, state=state), config, scene


def test_the_first_step_is_the_learning_rate(dataset, cpu):
    one, config, before = going_on(cpu, dataset)
    one.step()
    moved = np.abs(one.parameters.download_anchors(cpu).feature - before.anchors.feature)
    rate = learning_rates(config, STEP + 1, dataset.radius)["feature"]
    changed = moved[moved > 0]
    assert len(changed) > 1000
    # Adam's first step is rate * g / (|g| + 1e-15): the rate, but for float32 rounding of features
    assert abs(np.median(changed) / rate - 1) < 1e-3
    assert changed.max() < 1.01 * rate


def test_a_checkpoint_keeps_it(dataset, cpu, tmp_path):
    one, _, _ = going_on(cpu, dataset)
    one.step()
    one.save(tmp_path / "checkpoint")
    other, _, _ = going_on(cpu, dataset)
    other.state.begun = 0
    other.resume(tmp_path / "checkpoint")
    assert (other.state.step, other.state.begun) == (STEP + 1, STEP)
    list(one.steps(3))
    list(other.steps(3))
    assert arrays_of(cpu, one.state) == arrays_of(cpu, other.state)


def test_means_are_of_the_steps_that_it_does_itself(dataset, cpu):
    """A few steps at the end of a run: the networks end where those steps took them."""
    last = 240
    one, config, before = going_on(cpu, dataset, last - 3)
    assert last - 3 > config.freeze_step
    list(one.steps(3))
    rates = learning_rates(config, last - 2, dataset.radius)
    farthest = 3 * max(rate for name, rate in rates.items() if name.startswith("mlp"))
    moved = np.abs(cpu.download(one.parameters.scene.weights) - before.mlps.flat)
    assert 0 < moved.max() < 1.01 * farthest
