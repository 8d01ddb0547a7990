"""The MLPs that runs start from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_encoder import encode
from clgs.constants import FEATURE_DIM, HEAD_DIMS
from clgs.errors import CodecError, DataError
from clgs.scene.mlps import MLP_SIZE, init_mlps
from clgs.scene.storage import save_scene
from clgs.train.config import preset
from clgs.train.config.run_settings import OBJECTS, RANDOM, TRAINED
from clgs.train.run.load import start_mlps
from clgs.train.run.trainer import Trainer
from tests.codec.scenes import random_scene

LIVE, STEPS = 40, 3
"""Features that networks for objects read; steps of training."""


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_random_ones_are_those_of_the_seed():
    np.testing.assert_array_equal(start_mlps(RANDOM, rng()).flat, init_mlps(rng()).flat)


def test_trained_ones_are_the_same_for_all_seeds():
    flat = start_mlps(TRAINED, rng()).flat
    assert flat.shape == (MLP_SIZE,)
    assert np.isfinite(flat).all()
    np.testing.assert_array_equal(flat, start_mlps(TRAINED, np.random.default_rng(6)).flat)


def test_features_that_networks_for_objects_do_not_read_stay_zero(dataset, cpu):
    config = preset("default").scaled(400)
    config = replace(config, voxel=0.02).for_dataset(dataset.kind)
    assert (config.start_mlps, preset("default").for_dataset("colmap").start_mlps) == (
        OBJECTS,
        TRAINED,
    )
    weights = start_mlps(OBJECTS, rng())
    read = np.any([weights.head(name)["hidden_weight"] != 0 for name in HEAD_DIMS], axis=(0, 1))
    assert read[:LIVE].all()
    assert read[FEATURE_DIM:].all()  # the direction
    assert not read[LIVE:FEATURE_DIM].any()
    trainer = Trainer(cpu, dataset, config)
    for _ in range(STEPS):
        trainer.step()
    trained = cpu.download(trainer.parameters.scene.anchors.feature)
    assert trained[:, :LIVE].any(axis=0).all()
    assert not trained[:, LIVE:].any()


@pytest.mark.parametrize("suffix", [".npz", ".clgs", ""])
def test_those_of_a_scene(tmp_path, suffix):
    scene, path = random_scene(rng()), tmp_path / f"scene{suffix}"
    if suffix == ".npz":
        save_scene(path, scene)
    else:
        file = path if suffix else path / "scene.clgs"
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(encode(scene))
    np.testing.assert_allclose(start_mlps(str(path), rng()).flat, scene.mlps.flat, atol=0.02)


@pytest.mark.parametrize("name", ["nothing.clgs", "nothing.npz", "photo.png", "gone"])
def test_what_is_no_scene_is_refused(tmp_path, name):
    with pytest.raises(DataError, match=r"start_mlps|[Nn]o such file"):
        start_mlps(str(tmp_path / name), rng())


def test_damaged_scenes_are_refused(tmp_path):
    path = tmp_path / "scene.clgs"
    path.write_bytes(b"CLGS" + bytes(40))
    with pytest.raises(CodecError, match=r"scene\.clgs: "):
        start_mlps(str(path), rng())


def test_runs_start_from_them(dataset, cpu):
    settings = replace(preset("default").scaled(400), voxel=0.02).for_dataset(dataset.kind)
    assert preset("paper").for_dataset("blender").start_mlps == RANDOM
    for name in (TRAINED, RANDOM):
        trainer = Trainer(cpu, dataset, replace(settings, start_mlps=name))
        found = cpu.download(trainer.parameters.scene.weights)
        np.testing.assert_array_equal(found, start_mlps(name, np.random.default_rng(0)).flat)


def test_photos_start_from_fewer_points_than_pixels(dataset, cpu):
    settings = replace(preset("default").scaled(400), voxel=0.02, start_pixels=4.0)
    photos = replace(dataset, kind="colmap")
    counts = [
        Trainer(cpu, photos, one.for_dataset("colmap")).parameters.count
        for one in (settings, replace(settings, start_pixels=0.0), replace(settings, max_anchors=9))
    ]
    whole = Trainer(cpu, dataset, settings.for_dataset("blender")).parameters.count
    assert counts == [40 * 40 // 4, whole, 9]
    assert whole > counts[0]
