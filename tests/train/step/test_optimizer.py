"""Parameters end with the mean over the last steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.train.config import preset
from clgs.train.config.run_settings import TRAINED
from clgs.train.run.trainer import Trainer
from tests.train.state.test_run_state import arrays_of

STEPS = 60


def config(dataset, **changes):
    settings = replace(preset("default").scaled(STEPS), voxel=0.02, **changes)
    return settings.for_dataset(dataset.kind)


def followed(cpu, dataset, **changes):
    """The trainer, and a host copy of all tensors after each step but the last; (trainer, list)."""
    trainer = Trainer(cpu, dataset, config(dataset, **changes), ahead=False)
    seen = []
    for _ in range(STEPS):
        trainer.step()
        scene = trainer.parameters.scene
        seen.append({name: cpu.download(array).astype(np.float64) for name, array in scene.items()})
    return trainer, seen


@pytest.mark.slow
@pytest.mark.parametrize("price", [0.0, 0.3])
def test_they_end_with_means(cpu, dataset, price):
    # the last steps move these networks further than their rounding does
    trainer, seen = followed(cpu, dataset, size_lambda=price, start_mlps=TRAINED)
    settings, end = trainer.config, seen[-1]
    begin = max([settings.prune_end, *trainer.economy.steps])
    assert begin < settings.freeze_step < STEPS
    for name in ("feature", "offset", "scaling"):
        mean = np.mean([one[name] for one in seen[begin : settings.freeze_step]], axis=0)
        np.testing.assert_allclose(end[name], mean, atol=1e-5)
        assert np.abs(end[name] - seen[settings.freeze_step - 1][name]).max() > 1e-3
    before = np.mean([one["weights"] for one in seen[settings.freeze_step : -1]], axis=0)
    assert np.abs(end["weights"] - before).max() < np.abs(seen[-2]["weights"] - before).max()


@pytest.mark.slow
def test_without_means_they_end_with_the_last_step(cpu, dataset):
    trainer, seen = followed(cpu, dataset, average=False)
    frozen = seen[trainer.config.freeze_step - 1]
    assert all(np.array_equal(seen[-1][name], frozen[name]) for name in ("feature", "offset"))
    assert not trainer.state.means.tensors


@pytest.mark.slow
def test_steps_ahead_change_no_bit(cpu, dataset):
    ends = []
    for ahead in (True, False):
        trainer = Trainer(cpu, dataset, config(dataset), ahead=ahead)
        list(trainer.steps(STEPS))
        ends.append(arrays_of(cpu, trainer.state))
    assert ends[0] == ends[1]
