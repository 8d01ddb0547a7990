"""A run knows its data set again."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from clgs.data.dataset import load_dataset
from clgs.data.origin import ORIGIN, alike, read_origin, write_origin
from clgs.errors import DataError
from clgs.scene.scene import SceneTransform
from tests.small_scene import write_scene


@pytest.fixture
def data(tmp_path):
    return write_scene(tmp_path / "data", train=12, test=2)


def loaded(folder):
    return load_dataset(folder, load_images=False)


def turned(view):
    """The view from the other side."""
    back = np.diag([-1.0, 1.0, -1.0])
    return replace(view, camera=replace(view.camera, rotation=view.camera.rotation @ back))


def test_run_names_its_data(tmp_path, data):
    dataset = loaded(data)
    write_origin(tmp_path, dataset)
    origin = read_origin(tmp_path)
    assert origin.folder == data
    assert len(origin.cameras) == 8
    assert origin.check(dataset.train + dataset.test, data)


def test_run_and_data_may_move_together(tmp_path, data):
    (tmp_path / "run").mkdir()
    write_origin(tmp_path / "run", loaded(data))
    (tmp_path / "there").mkdir()
    for name in ("run", "data"):
        shutil.move(tmp_path / name, tmp_path / "there" / name)
    origin = read_origin(tmp_path / "there" / "run")
    assert origin.folder.resolve() == tmp_path / "there" / "data"


def test_other_cameras_are_refused(tmp_path, data):
    dataset = loaded(data)
    write_origin(tmp_path, dataset)
    with pytest.raises(DataError, match=r"the camera of .* is not the one"):
        read_origin(tmp_path).check([turned(view) for view in dataset.train], data)


def test_new_photos_of_the_place_are_welcome(tmp_path, data):
    dataset = loaded(data)
    write_origin(tmp_path, dataset)
    new = [replace(turned(view), name=f"new_{view.name}") for view in dataset.train]
    assert not read_origin(tmp_path).check(new, data)


def test_data_in_memory_have_no_folder(tmp_path, data):
    write_origin(tmp_path, replace(loaded(data), folder=None))
    assert read_origin(tmp_path) is None


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"folder": 1, "relative": "", "radius": 1}'])
def test_damaged_record_is_named(tmp_path, text):
    (tmp_path / ORIGIN).write_text(text)
    with pytest.raises(DataError, match=r"data\.json: is damaged; remove it and use --data"):
        read_origin(tmp_path)


def test_cameras_of_wrong_shape_are_named(tmp_path, data):
    write_origin(tmp_path, loaded(data))
    record = json.loads((tmp_path / ORIGIN).read_text())
    record["cameras"] = {"a": [1, 2]}
    (tmp_path / ORIGIN).write_text(json.dumps(record))
    with pytest.raises(DataError, match="is damaged"):
        read_origin(tmp_path)


@pytest.mark.parametrize(
    ("scale", "shift", "expected"),
    [(1.0, 0.0, True), (1.1, 0.1, True), (1.5, 0.0, False), (1.0, 2.0, False)],
)
def test_transforms_of_one_capture_are_alike(scale, shift, expected):
    one = SceneTransform((1.0, 0.0, 0.0), 2.0)
    other = SceneTransform((1.0 + shift, 0.0, 0.0), 2.0 * scale)
    assert alike(one, other, 4.4) == expected
