"""Points of a ray-cast room at known poses lie on its walls; the cache; determinism."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.cli.main import main
from clgs.data.dataset import read_photo_set
from clgs.data.posed_photo import Photo
from clgs.poses import triangulate as module
from clgs.poses.triangulate import Points, triangulate
from tests.data.folders import noise_image, write_room

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")


@pytest.fixture(autouse=True)
def user_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder in which nothing is yet."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("CLGS_CACHE", str(folder))
    return folder / "photos"


def photos(root: Path) -> list[Photo]:
    return read_photo_set(root).train


def room_points(root: Path, cache: Path | None = None, seed: int = 0) -> Points:
    return triangulate(photos(root), cache, seed)


@pytest.mark.slow
def test_points_lie_on_the_walls_and_are_cached(tmp_path: Path):
    write_room(tmp_path / "room", 8)
    before = sorted(tmp_path.rglob("*"))
    points = room_points(tmp_path / "room")
    assert sorted(tmp_path.rglob("*")) == before
    assert len(points.position) >= 300
    off_wall = np.abs(points.position).min(axis=1)
    assert np.median(off_wall) <= 0.005
    assert np.percentile(off_wall, 95) <= 0.05
    assert np.ptp(points.color, axis=1).max() == 0

    cache = tmp_path / "run"
    again = room_points(tmp_path / "room", cache)
    assert np.array_equal(again.position, points.position)
    (file,) = cache.iterdir()
    np.savez(file, position=points.position[:5], color=points.color[:5])
    assert len(room_points(tmp_path / "room", cache).position) == 5
    file.write_bytes(b"damaged")
    assert len(room_points(tmp_path / "room", cache).position) == len(points.position)
    assert len(list(cache.iterdir())) == 1


@pytest.mark.slow
def test_another_run_takes_the_points_of_the_first(
    tmp_path: Path, user_cache: Path, monkeypatch: pytest.MonkeyPatch
):
    write_room(tmp_path / "room", 3, (64, 48))
    points = room_points(tmp_path / "room", tmp_path / "run")
    (kept,) = user_cache.iterdir()
    with monkeypatch.context() as patched:
        patched.setattr(module, "run_child", lambda *_: pytest.fail("points are searched for"))
        again = room_points(tmp_path / "room", tmp_path / "other")
        assert np.array_equal(again.position, points.position)
        kept.unlink()  # the other run can go on without it
        room_points(tmp_path / "room", tmp_path / "other")
        assert kept.is_file()
    shutil.rmtree(user_cache)
    user_cache.write_bytes(b"no folder")
    again = room_points(tmp_path / "room")
    assert np.array_equal(again.position, points.position)


@pytest.mark.slow
def test_changed_images_are_not_answered_from_the_cache(tmp_path: Path):
    write_room(tmp_path / "room", 3, (64, 48))
    cache = tmp_path / "run"
    room_points(tmp_path / "room", cache)
    Image.fromarray(noise_image(64, 48)).save(tmp_path / "room" / "images" / "1.png")
    room_points(tmp_path / "room", cache)
    room_points(tmp_path / "room", cache, seed=1)
    assert len(list(cache.iterdir())) == 3


@pytest.mark.slow
def test_seeds_may_be_larger_than_pycolmap_takes(tmp_path: Path):
    write_room(tmp_path / "room", 3, (64, 48))
    points = [room_points(tmp_path / "room", seed=seed).position for seed in (7, 2**40 + 7)]
    assert np.array_equal(*points)


@pytest.mark.slow
def test_the_search_for_points_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_room(tmp_path / "room", 5, (64, 48))
    command = ["train", str(tmp_path / "room"), "-o", str(tmp_path / "run"), "--steps", "1"]
    assert main([*command, "--resume"]) == 0
    out, err = capsys.readouterr()
    assert "finding points" not in out
    assert err.splitlines()[:3] == [
        f"clgs: finding points in {len(photos(tmp_path / 'room'))} photos",
        "clgs: matching their features",
        "clgs: triangulating the matches",
    ]
    assert main([*command, "--resume"]) == 0  # from the cache in the run folder
    assert "finding points" not in capsys.readouterr().err
