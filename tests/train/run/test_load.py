"""What training starts from: points of the data set, triangulated or random ones; MLPs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_encoder import encode
from clgs.constants import FEATURE_DIM, HEAD_DIMS
from clgs.data.dataset import load_dataset
from clgs.errors import CodecError, DataError, UsageError
from clgs.scene.mlps import MLP_SIZE, init_mlps
from clgs.scene.storage import save_scene
from clgs.train.config import TrainConfig, preset
from clgs.train.config.run_settings import OBJECTS, RANDOM, TRAINED
from clgs.train.run import load
from clgs.train.run.load import first_state, load_for, start_mlps, with_points
from clgs.train.run.trainer import Trainer
from clgs.train.state.voxel_grid import voxel_integers
from tests.codec.scenes import random_scene
from tests.data.folders import (
    project,
    save_json,
    write_blender,
    write_colmap,
    write_room,
    write_transforms,
)


@pytest.mark.slow
def test_points_are_triangulated_once(tmp_path, monkeypatch):
    monkeypatch.setenv("CLGS_CACHE", str(tmp_path / "cache"))
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    write_room(tmp_path / "data", 6)
    stages: list[str] = []
    config, cache = TrainConfig(), tmp_path / "run"
    data = load_for(config, tmp_path / "data", cache, stages.append)
    assert len(data.points) >= load.MIN_TRIANGULATED
    assert data.point_colors is not None
    assert "finding points in 5 photos" in stages[0]
    assert len(list(cache.glob("points-*.npz"))) == 1
    read = load_dataset(tmp_path / "data")
    assert len(read.points) == 0
    again = with_points(read, cache=cache, on_stage=lambda stage: pytest.fail(stage))
    assert np.array_equal(again.points, data.points)
    assert with_points(again) is again
    few = with_points(replace(read, train=read.train[:4]), cache=cache, on_stage=stages.append)
    assert "finding points in 4 photos" in stages
    assert len(few.points) != len(data.points)


def test_a_start_has_the_number_of_points_that_is_asked_for(tmp_path):
    write_blender(tmp_path)
    data = load_dataset(tmp_path)
    assert len(with_points(data, TrainConfig(start_points=500)).points) == 500
    cube = with_points(data, TrainConfig(start_points=5000, start_volume="cube")).points
    assert len(cube) == 5000
    assert np.abs(cube).max() <= 1.3
    assert (np.abs(cube) > 1.2).any()  # where photos show background, too
    np.testing.assert_allclose(cube.mean(axis=0), 0.0, atol=0.06)


def test_blender_points_are_carved_and_seeded(tmp_path):
    write_blender(tmp_path)
    read = load_dataset(tmp_path)
    assert len(read.points) == 0
    data = with_points(read)
    assert (data.kind, len(data.train), len(data.test), data.skipped) == ("blender", 8, 3, 0)
    assert data.transform.scale == 1.0
    assert 27_000 <= len(data.points) <= 30_000
    distance = np.linalg.norm(data.points, axis=1)
    # The masks are grown by 2 pixels of 40, about 0.2 units; views from one height only leave
    # cones above and below the ball.
    assert np.hypot(*data.points[:, :2].T).max() <= 0.8
    assert distance.max() <= 1.3
    assert np.array_equal(with_points(read).points, data.points)
    assert not np.array_equal(with_points(read, TrainConfig(seed=1)).points, data.points)


def test_points_of_blender_scenes_lie_near_the_surface_of_the_hull_more_often(tmp_path):
    write_blender(tmp_path)
    points = with_points(load_dataset(tmp_path)).points
    distance = np.hypot(*points[np.abs(points[:, 2]) < 0.2, :2].T)  # the middle of the ball
    assert (distance > 0.9 * distance.max()).mean() > 0.24  # 0.19 if they were even
    assert (distance < 0.5 * distance.max()).mean() > 0.15  # 0.25


def test_long_runs_begin_with_the_first_of_the_points(tmp_path, cpu):
    write_blender(tmp_path)
    data = with_points(load_dataset(tmp_path))
    found = {}
    for steps in (300, 3_000, 10_000, 30_000, 60_000):
        settings = preset("default").scaled(steps).for_dataset("blender")
        found[steps] = first_state(cpu, data, settings).parameters.count
    few = len(voxel_integers(data.points[:10_000], settings.voxel))
    assert found[300] == found[3_000] == len(voxel_integers(data.points, settings.voxel))
    assert few == found[30_000] == found[60_000] < found[10_000] < found[3_000]
    given = replace(settings, start_points=len(data.points))
    assert first_state(cpu, data, given).parameters.count == found[3_000]
    own = replace(data, drawn=False)
    assert first_state(cpu, own, settings).parameters.count == found[3_000]


def test_a_box_that_holds_none_of_the_first_anchors_is_refused(dataset, cpu):
    config = replace(preset("default").scaled(30), box="90,90,90,91,91,91")
    with pytest.raises(UsageError, match="90,91,91,91 holds none of the anchors that the run"):
        first_state(cpu, dataset, config.for_dataset(dataset.kind))


@pytest.mark.slow
def test_photos_that_do_not_match_start_from_random_points(tmp_path):
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    write_transforms(tmp_path)
    data = with_points(load_dataset(tmp_path), cache=tmp_path / "cache")
    assert len(data.points) >= 50_000
    assert data.point_colors is None
    seen = sum(
        np.all((project(v.camera, data.points) >= 0), axis=1).astype(int) for v in data.train
    )
    assert seen.min() >= len(data.train) / 2


def turn_around(document: dict) -> None:
    for frame in document["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, :3] = matrix[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
        frame["transform_matrix"] = matrix.tolist()


@pytest.mark.slow
def test_photos_from_the_middle_outwards_start_from_what_two_see(tmp_path, monkeypatch):
    monkeypatch.setattr(load, "triangulate", no_points)
    document = write_transforms(tmp_path, 40)
    turn_around(document)
    save_json(tmp_path, document)
    data = with_points(load_dataset(tmp_path))
    seen = sum(
        np.all((project(v.camera, data.points) >= 0), axis=1).astype(int) for v in data.train
    )
    assert len(data.points) >= 1000
    assert seen.min() >= 2


def no_points(*arguments: object) -> None:
    raise DataError("none")


def test_cameras_that_share_no_sight_are_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(load, "triangulate", no_points)
    document = write_transforms(tmp_path, 5)
    turn_around(document)
    save_json(tmp_path, document)
    with pytest.raises(DataError, match="no two photos look at the same place; check the poses"):
        with_points(load_dataset(tmp_path))


def test_a_single_training_photo_starts_from_random_points(tmp_path, caplog):
    write_transforms(tmp_path, 2)
    assert len(with_points(load_dataset(tmp_path)).points) >= 50_000
    (warning,) = [record.getMessage() for record in caplog.records]
    assert warning.endswith("starting from random ones: a single photo gives no depth")


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 3])
def test_a_model_of_few_points_starts_from_random_ones(tmp_path, caplog, count):
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    write_colmap(tmp_path, text=True)
    points = "".join(f"{i} 0 0 {i} 1 2 3 0.1\n" for i in range(1, count + 1))
    (tmp_path / "sparse" / "0" / "points3D.txt").write_text(points)
    data = with_points(load_dataset(tmp_path))
    assert len(data.points) >= 50_000
    assert data.point_colors is None
    assert f"only {count} usable points, starting from random ones" in caplog.text


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
    list(trainer.steps(STEPS))
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
