"""The cameras of one capture, read from the forms of several programs, are those of COLMAP's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clgs.data.dataset import load_dataset
from clgs.doctor import ERROR
from clgs.doctor.dataset import examine
from clgs.errors import DataError
from clgs.render.renderer import Renderer
from clgs.scene.gaussians import OrdinaryGaussians
from clgs.scene.scene import SplatScene
from clgs.scene.world import EARTH, MAP, METRES
from tests.data.programs.captures import FORMS, PLACE, Capture

BROWN = {"k1": -0.08, "k2": 0.03, "k3": -0.004, "p1": 0.0012, "p2": -0.0007}
FISHEYE = {"k1": 0.03, "k2": -0.01, "k3": 0.002, "k4": -0.0003}
PINHOLE = dict.fromkeys(("polycam", "record3d", "record3d, one lens"))
OTHERS = [name for name in FORMS if name != "colmap"]


def capture_of(folder: Path, form: str) -> Capture:
    """A capture whose lens the form can hold."""
    if form in PINHOLE:
        return Capture(folder, focal=(150.0, 149.0), model="PINHOLE")
    return Capture(folder, coefficients=BROWN)


def load_alike(one: Path, other: Path):
    """Two data sets with their views in pairs; they see the same photos in the same places."""
    first, second = load_dataset(one), load_dataset(other)
    assert len(first.train) == len(second.train) == 5
    assert len(first.test) == len(second.test) == 1
    pairs = zip(first.train + first.test, second.train + second.test, strict=True)
    return first, second, list(pairs)


@pytest.mark.slow
@pytest.mark.parametrize("form", OTHERS)
def test_cameras_and_photos_are_those_of_the_colmap_form(tmp_path, form):
    capture = capture_of(tmp_path, form)
    expected, found, pairs = load_alike(capture.form("colmap"), capture.form(form))
    for wanted, view in pairs:
        assert np.abs(view.camera.rotation - wanted.camera.rotation).max() <= 1e-6
        assert np.abs(view.camera.translation - wanted.camera.translation).max() <= 1e-6
        for name in ("fx", "fy", "cx", "cy"):
            assert abs(getattr(view.camera, name) - getattr(wanted.camera, name)) <= 1e-6
        assert np.array_equal(view.photo.pixels().color, wanted.photo.pixels().color)
    assert abs(found.transform.scale / expected.transform.scale - 1) <= 1e-9
    if form != "metashape on the Earth":
        assert np.abs(np.subtract(found.transform.centre, expected.transform.centre)).max() <= 1e-6


@pytest.mark.parametrize("form", ["metashape", "opensfm"])
def test_fisheye_is_that_of_the_colmap_form(tmp_path, form):
    capture = Capture(tmp_path, (95.0, 95.0), coefficients=FISHEYE, model="OPENCV_FISHEYE")
    _, _, pairs = load_alike(capture.form("colmap"), capture.form(form))
    for wanted, view in pairs:
        assert np.abs(view.camera.translation - wanted.camera.translation).max() <= 1e-6
        assert np.array_equal(view.photo.pixels().color, wanted.photo.pixels().color)


def test_fisheye_photos_show_the_chosen_view(tmp_path):
    capture = Capture(tmp_path, (60.0, 60.0), coefficients=FISHEYE, model="OPENCV_FISHEYE")
    root = capture.form("metashape")
    whole, narrow = load_dataset(root).train[0], load_dataset(root, fisheye_view=70).train[0]
    assert narrow.camera.width < whole.camera.width
    assert abs(narrow.camera.width / 2 - 60 * np.tan(np.radians(35))) <= 1
    assert narrow.photo.pixels().size == (narrow.camera.width, narrow.camera.height)
    left = round(whole.camera.cx - narrow.camera.cx)
    top = round(whole.camera.cy - narrow.camera.cy)
    part = whole.photo.pixels().color[top:, left:][: narrow.camera.height, : narrow.camera.width]
    assert np.array_equal(narrow.photo.pixels().color, part)
    with pytest.raises(DataError, match="fisheye_view is 5; give 0 or 10 to 160 degrees"):
        load_dataset(root, fisheye_view=5)


@pytest.mark.slow
@pytest.mark.parametrize("form", OTHERS)
def test_the_same_picture_is_rendered(tmp_path, form, open_device):
    capture = capture_of(tmp_path, form)
    expected, _, pairs = load_alike(capture.form("colmap"), capture.form(form))
    mean = expected.transform.to_scene(capture.points).astype(np.float32)
    rng = np.random.default_rng(0)
    single = [rng.normal(size=(len(mean), size)).astype(np.float32) for size in (3, 4, 1, 3)]
    gaussians = OrdinaryGaussians(
        mean, 0.3 * single[0] - 1.5, single[1], single[2][:, 0] + 2, single[3][:, None]
    )
    renderer = Renderer(open_device("cpu"), SplatScene(gaussians))
    for pair in pairs[:2]:
        wanted, found = (np.asarray(renderer.render(view.camera)) for view in pair)
        assert wanted.std() > 0.1
        # a turn and a shift of 1e-6 move what is drawn by less than 1e-3 of a pixel
        assert np.abs(wanted - found).max() <= 1e-3


def test_points_come_along(tmp_path):
    capture = Capture(tmp_path, coefficients=BROWN)
    expected = load_dataset(capture.form("colmap")).points
    for form in ("opensfm", "realityscan"):
        found = load_dataset(capture.form(form))
        assert np.abs(found.points - expected).max() <= 1e-5
    assert load_dataset(capture.form("opensfm")).point_colors.tolist() == [[9, 90, 200]] * 50


def test_worlds_are_known(tmp_path):
    capture = Capture(tmp_path)
    frames = {form: load_dataset(capture.form(form)).transform for form in OTHERS}
    for form in ("metashape on the Earth", "opensfm"):
        assert frames[form].frame == EARTH
    assert frames["opensfm"].place == PLACE
    for form in ("metashape", "realityscan", "opendronemap", "polycam", "record3d"):
        assert frames[form].frame == METRES
    place = frames["metashape on the Earth"].place
    assert np.abs(np.subtract(place[:2], PLACE[:2])).max() <= 1e-12
    assert abs(place[2] - PLACE[2]) <= 1e-7


@pytest.mark.parametrize("form", OTHERS)
def test_missing_photos_are_named_and_the_doctor_finds_no_error(tmp_path, form, caplog):
    root = capture_of(tmp_path, form).form(form)
    photo = sorted(root.rglob("*.png"))[2]
    photo.unlink()
    found = load_dataset(root, load_images=False)
    assert (len(found.train) + len(found.test), found.skipped) == (5, 1)
    assert "1 of 6 photos are missing" in caplog.text
    assert photo.stem in caplog.text
    findings = examine(root).findings
    assert not [one for one in findings if one.level == ERROR]
    assert any("1 of 6 photos are missing" in one.problem for one in findings)


def test_a_map_is_told_from_a_world_of_its_own(tmp_path):
    far = np.eye(4)
    far[:3, 3] = 602_123.5, 5_200_321.25, 431.0
    capture = Capture(tmp_path)
    near = load_dataset(capture.form("realityscan"))
    capture = replace(capture, poses=[far @ pose for pose in capture.poses])
    capture.points = capture.points + far[:3, 3]
    found = load_dataset(capture.form("realityscan"))
    assert found.transform.frame == MAP
    assert (
        np.abs(np.subtract(found.transform.centre, near.transform.centre) - far[:3, 3]).max() < 1e-8
    )
    for one, other in zip(found.train, near.train, strict=True):
        assert np.abs(one.camera.translation - other.camera.translation).max() <= 1e-6


@pytest.mark.parametrize("form", OTHERS)
def test_files_in_capitals_are_read(tmp_path, form):
    capture = capture_of(tmp_path, form)
    wanted = load_dataset(capture.form(form), load_images=False)
    root = capture.form(form)
    for path in [*root.rglob("*")]:
        if path.is_file() and path.suffix.lower() not in (".png", ".jpg"):
            path.rename(path.with_name(path.name.upper()))
    found = load_dataset(root, load_images=False)
    assert found.kind == wanted.kind
    assert [view.name for view in found.train] == [view.name for view in wanted.train]
