"""Weights of the MLPs in the last steps: rounded as they are stored, and still learning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.reader import decode_weights
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import MLPS, read_container
from clgs.reference import quantize as reference
from clgs.scene.mlps import HEAD_DIMS, head_slice
from clgs.train.config import preset
from clgs.train.run.trainer import Trainer
from clgs.train.state.rounding import BINARY_PLACES, weight_scales

STEPS, SWITCH = 60, 48


def config(dataset, **changes):
    settings = replace(preset("default").scaled(STEPS), voxel=0.05, **changes)
    return settings.for_dataset(dataset.kind)


def weights(trainer):
    return trainer.device.download(trainer.parameters.scene.weights)


def rendered(trainer, step):
    return trainer.device.download(trainer.rounding.scene_at(trainer.state, step).weights)


@pytest.fixture(scope="module")
def start(dataset, open_device, tmp_path_factory):
    """Checkpoints of one run at the last step before rounding, quantised and float32."""
    folders = {}
    for mlp in ("quantized", "float32"):
        trainer = Trainer(open_device("cpu"), dataset, config(dataset, mlp=mlp))
        list(trainer.steps(SWITCH))
        folders[mlp] = tmp_path_factory.mktemp(mlp)
        trainer.save(folders[mlp])
    return folders


def resumed(start, dataset, device, mlp="quantized"):
    trainer = Trainer(device, dataset, config(dataset, mlp=mlp))
    trainer.resume(start[mlp])
    return trainer


def test_both_ways_are_one_until_the_switch(start, dataset, cpu):
    one, other = (resumed(start, dataset, cpu, mlp) for mlp in start)
    assert one.config.mlp_switch_step == SWITCH
    assert np.array_equal(weights(one), weights(other))
    assert np.array_equal(rendered(one, SWITCH), weights(one))
    assert one.step() != other.step()


def test_the_stored_weights_are_those_that_were_rendered(start, dataset, cpu):
    trainer = resumed(start, dataset, cpu)
    before = trainer.psnr(dataset.train)
    list(trainer.steps(STEPS - SWITCH))
    assert trainer.psnr(dataset.train) > before
    stored = trainer.quantized_scene().mlps.flat
    assert np.array_equal(stored, rendered(trainer, STEPS))
    assert np.array_equal(stored, reference.elements(weights(trainer), weight_scales()))
    multiples = stored * weight_scales()
    assert np.array_equal(multiples, np.rint(multiples))
    assert not np.array_equal(stored, weights(trainer))  # the optimiser keeps its own
    section = read_container(encode(trainer.quantized_scene()))[1][MLPS]
    assert section.data[0] == 2
    assert len(section.data) < 15_000
    assert np.array_equal(decode_weights(section), stored)


def test_every_head_goes_on_learning(start, dataset, cpu):
    trainer = resumed(start, dataset, cpu)
    before = weights(trainer)
    list(trainer.steps(STEPS - SWITCH))
    after = weights(trainer)
    for head in HEAD_DIMS:
        part = head_slice(head)
        assert np.mean(before[part] != after[part]) > 0.5


def test_resumes_to_the_bit_among_rounded_steps(start, dataset, cpu, tmp_path):
    whole = resumed(start, dataset, cpu)
    list(whole.steps(5))
    whole.save(tmp_path)
    again = Trainer(cpu, dataset, config(dataset))
    again.resume(tmp_path)
    assert list(whole.steps(5)) == list(again.steps(5))
    assert np.array_equal(weights(whole), weights(again))


def test_float32_leaves_the_weights_alone(start, dataset, cpu):
    trainer = resumed(start, dataset, cpu, "float32")
    list(trainer.steps(3))
    assert np.array_equal(rendered(trainer, STEPS), weights(trainer))
    assert np.array_equal(trainer.quantized_scene().mlps.flat, weights(trainer))


def test_gradients_pass_the_rounding_unchanged(start, dataset, cpu):
    """A step from rounded weights moves by what a step from the same weights, unrounded, does."""
    trainers = [resumed(start, dataset, cpu, mlp) for mlp in start]
    on_grid = reference.elements(weights(trainers[0]), weight_scales())
    for trainer in trainers:
        cpu.write(trainer.parameters.scene.weights, on_grid)
        trainer.step()
    assert np.array_equal(weights(trainers[0]), weights(trainers[1]))


def test_scales_are_powers_of_two_by_layer():
    scales = weight_scales()
    assert np.all(np.frexp(scales)[0] == 0.5)
    for head, (hidden, output) in BINARY_PLACES.items():
        part = scales[head_slice(head)]
        assert (part[0], part[-1]) == (2.0**hidden, 2.0**output)
