"""A scene that goes on without its moments moves at first by its learning rates, as a new one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgs.train.config import preset
from clgs.train.run.load import state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.train.step.schedule import learning_rates

STEP = 100
"""The number of the step that the scene has done."""


def going_on(device, dataset, begun):
    """A run of a trained scene, its settings, and the features before its next step."""
    config = replace(preset("default").scaled(240), voxel=0.02).for_dataset(dataset.kind)
    first = Trainer(device, dataset, config)
    list(first.steps(5))
    scene = first.quantized_scene().dequantize()
    state = state_of_scene(device, dataset, config, scene, STEP)
    state.begun = begun
    return Trainer(device, dataset, config, state=state), config, scene.anchors.feature


def test_the_first_step_is_the_learning_rate(dataset, cpu):
    one, config, before = going_on(cpu, dataset, STEP)
    one.step()
    moved = np.abs(one.parameters.download_anchors(cpu).feature - before)
    rate = learning_rates(config, STEP + 1, dataset.radius)["feature"]
    changed = moved[moved > 0]
    assert len(changed) > 1000
    # Adam's first step is rate * g / (|g| + 1e-15): the rate, but for float32 rounding of features
    assert abs(np.median(changed) / rate - 1) < 1e-3
    assert changed.max() < 1.01 * rate


def test_a_checkpoint_keeps_it(dataset, cpu, tmp_path):
    one, _, _ = going_on(cpu, dataset, STEP)
    one.step()
    one.save(tmp_path / "checkpoint")
    other, _, _ = going_on(cpu, dataset, 0)
    other.resume(tmp_path / "checkpoint")
    assert (other.state.step, other.state.begun) == (STEP + 1, STEP)
    list(one.steps(3))
    list(other.steps(3))
    for mine, theirs in zip(
        one.parameters.scene.items(), other.parameters.scene.items(), strict=True
    ):
        np.testing.assert_array_equal(cpu.download(mine[1]), cpu.download(theirs[1]))
