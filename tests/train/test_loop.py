"""Whole training steps: they learn, stop on bad numbers, repeat and resume to the bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.dataset import load_dataset
from clgs.train.config import preset
from clgs.train.loop import NonFiniteLossError, Trainer
from clgs.train.resume import load_checkpoint, save_checkpoint
from tests.small_scene import write_scene

STEPS = 240


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    whole = load_dataset(write_scene(tmp_path_factory.mktemp("balls")))
    return replace(whole, points=whole.points[::25])


@pytest.fixture
def cpu(open_device):
    return open_device("cpu")


def config(dataset, **changes):
    settings = replace(preset("default").scaled(STEPS), voxel=0.02, **changes)
    return settings.for_dataset(dataset.kind)


def parameters(trainer):
    scene, device = trainer.parameters.scene, trainer.device
    names = ("position", "offset", "feature", "scaling", "weights")
    return {name: device.download(getattr(scene, name)) for name in names}


@pytest.mark.parametrize("specialisation", ["cpu", "gpu"])
def test_learns_grows_and_quantises(dataset, open_device, specialisation):
    steps = STEPS if specialisation == "cpu" else 40
    trainer = Trainer(open_device(specialisation), dataset, config(dataset))
    start = trainer.psnr(dataset.test)
    results = [trainer.step() for _ in range(steps)]
    assert trainer.psnr(dataset.test) > start + 3
    if steps < STEPS:
        return
    assert len({result.anchors for result in results}) > 1  # anchors came or went
    assert any(result.rate_bits is not None for result in results)
    assert all(result.rate_bits is None for result in results[: STEPS // 2])
    scene = trainer.quantized_scene()
    assert len(scene.anchors) == trainer.parameters.count


def test_same_seed_same_bits(dataset, cpu):
    first, second = (Trainer(cpu, dataset, config(dataset)) for _ in range(2))
    for _ in range(130):
        assert first.step() == second.step()
    mine, theirs = parameters(first), parameters(second)
    assert all(np.array_equal(mine[name], theirs[name]) for name in mine)
    other = Trainer(cpu, dataset, config(dataset, seed=1))
    assert other.step() != Trainer(cpu, dataset, config(dataset)).step()


@pytest.mark.parametrize("interrupted", [37, 119, 121, 150])
def test_resumes_to_the_bit(dataset, cpu, tmp_path, interrupted):
    whole = Trainer(cpu, dataset, config(dataset))
    for _ in range(interrupted):
        whole.step()
    save_checkpoint(tmp_path, whole)
    resumed = Trainer(cpu, dataset, config(dataset))
    load_checkpoint(tmp_path, resumed)
    for _ in range(25):
        assert whole.step() == resumed.step()
    mine, theirs = parameters(whole), parameters(resumed)
    assert all(np.array_equal(mine[name], theirs[name]) for name in mine)


def test_non_finite_loss_leaves_parameters_alone(dataset, cpu):
    trainer = Trainer(cpu, dataset, config(dataset))
    trainer.step()
    weights = cpu.download(trainer.parameters.scene.weights)
    weights[4000] = np.nan  # a weight of the colour MLP
    cpu.write(trainer.parameters.scene.weights, weights)
    before = parameters(trainer)
    with pytest.raises(NonFiniteLossError, match=r"step 2, view \S*r_\d+"):
        trainer.step()
    after = parameters(trainer)
    assert all(np.array_equal(before[name], after[name], equal_nan=True) for name in before)
    assert trainer.steps_done == 1


def test_coarser_position_grid_merges_at_the_switch(dataset, cpu):
    trainer = Trainer(cpu, dataset, config(dataset, position_q=10.0))
    counts = [trainer.step().anchors for _ in range(STEPS // 2 + 1)]
    assert counts[-1] < counts[-2]
    assert trainer.merged == counts[-2] - counts[-1]
    position = cpu.download(trainer.parameters.scene.position)
    assert np.array_equal(position, (np.rint(position * 10) / 10).astype(np.float32))
