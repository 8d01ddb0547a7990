"""Folders to data sets: units, downscaling, initial points, the shared captures, bad folders."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.data.dataset import MAX_COORDINATE, SCENE_RADIUS, keep_near, load_dataset
from clgs.errors import DataError
from tests.data.folders import (
    move_cameras,
    noise_image,
    opengl,
    project,
    ring,
    save_json,
    write_colmap,
    write_transforms,
)
from tests.data.test_images import png
from tests.small_scene import write_scene


@pytest.mark.parametrize("times", [0.001, 0.1, 0.8, 1.2, 3.0, 1e4])
def test_blender_scenes_of_any_size_become_as_large_as_synthetic_ones(tmp_path, times):
    folder = write_scene(tmp_path / "data", train=6, test=1)
    usual = load_dataset(folder)
    for file in folder.glob("transforms_*.json"):
        move_cameras(file, lambda centre: times * centre)
    found, given = load_dataset(folder), load_dataset(folder, preset_units=True)
    assert usual.transform.scale == given.transform.scale == 1.0
    near = 2 / 3 < times < 1.5
    assert (found.transform.scale == 1.0) == near
    for view, other in zip(found.train, usual.train, strict=True):
        ratio = times if near else found.transform.scale * times
        assert ratio == pytest.approx(times if near else 1.0, rel=0.25)
        assert view.camera.centre == pytest.approx(ratio * other.camera.centre, rel=1e-6)


def test_files_that_look_like_masks_and_are_none_are_named(tmp_path, caplog):
    write_transforms(tmp_path)
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "mask_of_something.png").write_bytes(b"")
    load_dataset(tmp_path)
    assert "1 files look like masks, but are those of no photo and are not used" in caplog.text
    assert "masks/mask_of_something.png" in caplog.text


def test_scene_units_keep_the_projection(tmp_path):
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    write_colmap(tmp_path)
    scaled, given = load_dataset(tmp_path), load_dataset(tmp_path, preset_units=True)
    assert scaled.radius == SCENE_RADIUS
    centres = np.array([view.camera.centre for view in scaled.train])
    spread = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    assert 1.1 * spread == pytest.approx(SCENE_RADIUS)
    assert np.abs(centres.mean(axis=0)).max() <= 1e-9
    assert given.transform.scale == 1.0
    assert scaled.points.dtype == np.float32
    back = scaled.transform.to_world(scaled.points.astype(np.float64))
    assert np.abs(back - given.points).max() <= 1e-5
    for a, b in zip(scaled.train, given.train, strict=True):
        assert (
            np.abs(project(a.camera, scaled.points) - project(b.camera, given.points)).max() < 1e-3
        )


def test_far_offset_costs_no_precision(tmp_path):
    """Poses a million units away give the same pixels as poses around the origin."""
    offset = np.array([1e6, -2e6, 5e5])
    views = []
    for name, shift in (("near", np.zeros(3)), ("far", offset)):
        document = write_transforms(tmp_path / name)
        for frame, pose in zip(document["frames"], ring(10), strict=True):
            moved = pose.copy()
            moved[:3, 3] += shift
            frame["transform_matrix"] = opengl(moved)
        save_json(tmp_path / name, document)
        views.append(load_dataset(tmp_path / name, load_images=False).train[3].camera)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3)).astype(np.float32)
    packed = [c.pack(0.2).astype(np.float64) for c in views]
    assert np.abs(packed[0] - packed[1]).max() <= 1e-5
    assert np.abs(project(views[0], points) - project(views[1], points)).max() <= 1e-4


def test_photos_stay_in_memory_as_far_as_they_may(tmp_path):
    write_transforms(tmp_path, 5)
    whole = load_dataset(tmp_path).train
    kept = []
    two = 2 * 40 * 30 * 3
    for options in ({}, {"load_images": False}, {"photo_memory": 0}, {"photo_memory": two}):
        some = load_dataset(tmp_path, **options).train
        kept.append(sum(view.photo.has(None, 1) for view in some))
        for a, b in zip(some, whole, strict=True):
            np.testing.assert_array_equal(a.camera.pack(0.2), b.camera.pack(0.2))
            np.testing.assert_array_equal(a.photo.pixels().color, b.photo.pixels().color)
    assert kept == [4, 0, 0, 2]


def test_damaged_photos_are_found_before_training(tmp_path):
    write_transforms(tmp_path, 2)
    for number in (0, 1):  # held out, trained on
        path = tmp_path / "images" / f"{number:03d}.png"
        whole = path.read_bytes()
        for bad in (whole[: len(whole) // 2], png(2, (40, 30), bytes(29 * 121))):
            path.write_bytes(bad)
            with pytest.raises(DataError, match=rf"{path.name}: damaged image"):
                load_dataset(tmp_path)
        path.write_bytes(whole)


def test_every_photo_of_a_number_is_held_out_unless_the_data_set_says_which(tmp_path):
    def held_out(**options: int) -> list[str]:
        return [view.name[7:10] for view in load_dataset(tmp_path / "plain", **options).test]

    write_transforms(tmp_path / "plain", 6)
    assert held_out() == ["000"]
    assert held_out(test_every=3) == ["000", "003"]
    write_transforms(tmp_path / "plain", 6, test_filenames=["images/002.png"])
    assert held_out() == held_out(test_every=3) == ["002"]
    assert held_out(test_every=0) == []
    write_transforms(tmp_path / "single", 1)
    with pytest.raises(DataError, match="none is left to train on; --test-every 0 holds none out"):
        load_dataset(tmp_path / "single")
    assert len(load_dataset(tmp_path / "single", test_every=0).train) == 1


def test_a_photo_that_vanished_is_not_called_damaged(tmp_path):
    write_transforms(tmp_path, 2)
    view = load_dataset(tmp_path, photo_memory=0).train[0]
    (tmp_path / view.name).unlink()
    with pytest.raises(DataError, match=rf"{Path(view.name).name}: no such file; put it back"):
        view.photo.pixels()


@pytest.mark.parametrize("size", [(40, 30), (41, 31), (53, 39)])
@pytest.mark.parametrize("downscale", [1, 2, 3])
def test_downscaled_intrinsics(tmp_path, size, downscale):
    """A point keeps its place relative to the borders of the image at every size."""
    write_transforms(tmp_path, 4, size, cx=17.0)
    full = load_dataset(tmp_path, load_images=False, downscale=1).train[0].camera
    small = load_dataset(tmp_path, load_images=False, downscale=downscale).train[0].camera
    assert (small.width, small.height) == tuple(round(s / downscale) for s in size)
    with pytest.raises(DataError, match=f"the photos are {min(size)} pixels, give at most that"):
        load_dataset(tmp_path, load_images=False, downscale=min(size) + 1)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    ratio = np.array([small.width / full.width, small.height / full.height])
    expected = project(full, points) * ratio
    assert np.abs(project(small, points) - expected).max() <= 1e-9


def test_far_points_are_dropped():
    points = np.zeros((10, 3))
    points[0] = np.nan
    points[1] = 2 * MAX_COORDINATE
    points[2] = 1000.0
    points[3] = 100.0
    kept = keep_near(points, np.zeros(3), radius=4.4)
    assert kept.tolist() == [False] * 3 + [True] * 7
    far_away = points[4:] + np.array([300.0, 0, 0])
    assert keep_near(far_away, np.zeros(3), radius=4.4).all()
    assert not keep_near(points[:2], np.zeros(3), 4.4).any()


def test_one_camera_is_enough_for_units(tmp_path):
    write_transforms(tmp_path, 2, test_filenames=["images/001.png"])
    data = load_dataset(tmp_path, load_images=False)
    assert data.radius == SCENE_RADIUS
    assert data.transform.scale == 1.0


def test_bad_folders_are_one_line(tmp_path):
    with pytest.raises(DataError, match="no such folder"):
        load_dataset(tmp_path / "missing")
    with pytest.raises(DataError, match="check the path"):
        load_dataset(tmp_path)
    (tmp_path / "images").mkdir()
    Image.fromarray(noise_image(8, 8)).save(tmp_path / "images" / "a.jpg")
    with pytest.raises(DataError, match="clgs prepare"):
        load_dataset(tmp_path)


def test_parts_of_a_data_set_and_runs_are_named_as_what_they_are(tmp_path):
    data, run = tmp_path / "data", tmp_path / "run"
    write_transforms(data, 3)
    run.mkdir()
    (run / "config.toml").touch()
    said = rf"is a part of a data set; name the whole of it: {re.escape(str(data))}$"
    (data / "sparse" / "0").mkdir(parents=True)
    for part in ("images", "sparse/0"):
        with pytest.raises(DataError, match=said):
            load_dataset(data / part)
    with pytest.raises(DataError, match="is a run, no data set"):
        load_dataset(run)
    with pytest.raises(DataError, match="is a file; name the folder of the data set"):
        load_dataset(data / "images" / "000.png")


@pytest.mark.parametrize(("number", "far"), [(3, 1e3), (3, 1e8), (0, 1e8)])  # 0 is held out
def test_a_camera_astray_is_named_and_leaves_the_units_alone(tmp_path, caplog, number, far):
    document = write_transforms(tmp_path)
    document["frames"][number]["transform_matrix"][0][3] = far
    save_json(tmp_path, document)
    found = load_dataset(tmp_path, load_images=False)
    (warning,) = [one.getMessage() for one in caplog.records]
    assert "more than 20 times as far" in warning
    assert f"wrong: images/{number:03d}.png; leave" in warning
    assert 4.0 * found.transform.scale == pytest.approx(found.radius / 1.1, rel=0.2)


def test_cameras_in_one_place_are_named(tmp_path, caplog):
    write_transforms(tmp_path)
    move_cameras(tmp_path / "transforms.json", lambda _: np.full(3, 0.5))
    load_dataset(tmp_path, load_images=False)
    said = f"{tmp_path}: all cameras are in one place, so depth cannot be seen; walk, not turn"
    assert [one.getMessage() for one in caplog.records] == [said]


def test_missing_photos_are_named(tmp_path, caplog):
    write_transforms(tmp_path, 12)
    for number in range(2, 12):
        (tmp_path / "images" / f"{number:03d}.png").unlink()
    load_dataset(tmp_path, load_images=False)
    first = ", ".join(f"images/{number:03d}.png" for number in range(2, 10))
    assert [one.getMessage() for one in caplog.records] == [
        f"{tmp_path}: 10 of 12 photos are missing: {first}, ..."
    ]


def test_an_impossible_lens_is_refused(tmp_path):
    write_transforms(tmp_path, 4, k1=-9.0)
    with pytest.raises(DataError, match="distortion"):
        load_dataset(tmp_path, load_images=False)


@pytest.mark.slow
def test_shared_captures_have_the_known_counts(shared_data):
    expected = {"fox": (43, 7, 17), "nerf_synthetic_400/chair": (100, 200, 0)}
    if (shared_data / "fern_colmap_8").is_dir():
        pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
        expected["fern_colmap_8"] = (17, 3, 0)
    for name, counts in expected.items():
        data = load_dataset(shared_data / name, load_images=False)
        assert (len(data.train), len(data.test), data.skipped) == counts
