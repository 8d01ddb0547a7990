"""Many steps of training stay finite: families N17 and N28."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.dataset import load_dataset
from clgs.train.config import preset
from clgs.train.run.load import with_points
from clgs.train.run.trainer import Trainer
from tests.small_scene import write_scene


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    whole = with_points(load_dataset(write_scene(tmp_path_factory.mktemp("balls"))))
    return replace(whole, points=whole.points[::25])


def train(device, dataset, steps, **changes):
    """Steps of a whole run; a loss or gradient that is not finite raises."""
    config = replace(preset("default").scaled(steps), voxel=0.02, **changes)
    trainer = Trainer(device, dataset, config.for_dataset(dataset.kind))
    results = list(trainer.steps(steps))
    for name, array in trainer.parameters.scene.items():
        assert np.isfinite(device.download(array)).all(), name
    return trainer, results


@pytest.mark.slow
@pytest.mark.family("N28")
@pytest.mark.parametrize(
    ("specialisation", "seed"), [("cpu", 0), pytest.param("gpu", 1, marks=pytest.mark.slow)]
)
def test_every_gradient_is_finite(open_device, dataset, specialisation, seed):
    steps = 120
    if specialisation == "gpu":  # slow where the device is a CPU
        steps, dataset = 30, replace(dataset, points=dataset.points[::8])
    _, results = train(open_device(specialisation), dataset, steps, seed=seed)
    assert results[-1].loss < results[0].loss


@pytest.mark.release
@pytest.mark.family("N28")
def test_every_gradient_of_30000_steps_is_finite(open_device, dataset):
    _, results = train(open_device("cpu"), dataset, 30_000)
    losses = [result.loss for result in results]
    assert np.isfinite(losses).all()
    assert np.mean(losses[-100:]) < 0.5 * losses[0]


@pytest.mark.family("N28")
def test_shapes_without_thickness(open_device, dataset):
    """Training that starts from needles and dots as thin as log scales may become."""
    device = open_device("cpu")
    config = replace(preset("default").scaled(60), voxel=0.02).for_dataset(dataset.kind)
    trainer = Trainer(device, dataset, config)
    scaling = device.download(trainer.parameters.scene.anchors.scaling)
    scaling[::2, 3:5], scaling[1::2, 4:] = -20, -30
    device.write(trainer.parameters.scene.anchors.scaling, scaling)
    for _ in range(40):
        assert np.isfinite(trainer.step().loss)


@pytest.mark.family("N17")
@pytest.mark.parametrize("specialisation", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def test_training_goes_on_with_nothing_visible(open_device, dataset, specialisation):
    device = open_device(specialisation)
    away = [
        replace(view, camera=replace(view.camera, translation=np.array([0, 0, -50.0])))
        for view in dataset.train
    ]
    trainer, results = train(device, replace(dataset, train=away), 40, prune_opacity=0.0)
    assert len({result.loss for result in results}) <= len(away)
    fresh = Trainer(device, dataset, trainer.config)
    start = device.download(fresh.parameters.scene.weights)
    assert np.array_equal(device.download(trainer.parameters.scene.weights), start)
