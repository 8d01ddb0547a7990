"""Whole training steps: they learn, and repeat to the bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.train.config import MAX_WEIGHT, preset
from clgs.train.run.trainer import Trainer
from tests.train.state.test_run_state import arrays_of

STEPS = 240


def config(dataset, **changes):
    settings = replace(preset("default").scaled(STEPS), voxel=0.02, **changes)
    return settings.for_dataset(dataset.kind)


def features(trainer):
    return trainer.device.download(trainer.parameters.scene.anchors.feature)


@pytest.mark.parametrize("specialisation", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
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
    for _ in range(60):
        assert first.step() == second.step()
    assert arrays_of(cpu, first.state) == arrays_of(cpu, second.state)
    other = Trainer(cpu, dataset, config(dataset, seed=1))
    assert other.step() != Trainer(cpu, dataset, config(dataset)).step()


@pytest.mark.slow
def test_coarser_position_grid_merges_at_the_switch(dataset, cpu):
    trainer = Trainer(cpu, dataset, config(dataset, position_q=10.0, size_lambda=0.0))
    counts = [trainer.step().anchors for _ in range(STEPS // 2 + 1)]
    assert counts[-1] < counts[-2]
    assert trainer.state.merged == counts[-2] - counts[-1]
    position = cpu.download(trainer.parameters.scene.anchors.position)
    assert np.array_equal(position, (np.rint(position * 10) / 10).astype(np.float32))


@pytest.mark.slow
def test_visible_adam_leaves_unseen_rows_alone(dataset, cpu):
    one, dense = (
        Trainer(cpu, dataset, config(dataset, adam=kind)) for kind in ("visible", "dense")
    )
    for trainer in (one, dense):
        list(trainer.steps(40))
    assert one.psnr(dataset.test) > dense.psnr(dataset.test) - 1
    seen = cpu.download(one.render_next().activations.visible)
    before, dense_before = map(features, (one, dense))
    # hide all but some rows by moving the others behind every camera
    position = cpu.download(one.parameters.scene.anchors.position)
    hidden = np.setdiff1d(np.arange(len(position)), seen[:50])
    position[hidden] += 1e4
    for trainer in (one, dense):
        cpu.write(trainer.parameters.scene.anchors.position, position)
        trainer.step()
    after, dense_after = map(features, (one, dense))
    assert np.array_equal(after[hidden], before[hidden])
    assert not np.array_equal(dense_after[hidden], dense_before[hidden])  # momentum moves them
    assert not np.array_equal(after[seen[:50]], before[seen[:50]])


def test_the_largest_weights_train(dataset, cpu):
    most = MAX_WEIGHT
    trainer = Trainer(cpu, dataset, config(dataset, l1_weight=most, ssim_weight=most))
    start = trainer.psnr(dataset.test)
    list(trainer.steps(40))
    assert trainer.psnr(dataset.test) > start + 1


@pytest.mark.parametrize(
    ("steps", "smallest", "said"), [(9, 65536, 0), (10, 65536, 1), (25, 65536, 1), (12, 0, 0)]
)
def test_a_run_that_draws_nothing_is_warned_of_once(dataset, cpu, caplog, steps, smallest, said):
    trainer = Trainer(cpu, dataset, config(dataset, smallest_anchor=smallest))
    list(trainer.steps(steps))
    assert [record.levelname for record in caplog.records] == ["WARNING"] * said
    assert all("nothing was drawn in the first 10 steps" in one.message for one in caplog.records)


def test_a_shorter_run_that_draws_nothing_is_warned_of_at_its_end(dataset, cpu, caplog):
    trainer = Trainer(cpu, dataset, replace(config(dataset).scaled(4), smallest_anchor=65536))
    list(trainer.steps(4))
    assert "nothing was drawn in the first 4 steps" in caplog.text
