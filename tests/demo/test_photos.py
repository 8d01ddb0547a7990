import numpy as np
import photos
import pytest
from PIL import Image

from clgs.errors import DataError

WIDTH = 40


def test_views_are_enough_and_close_together():
    taken = list(photos.views(0))
    assert len(taken) >= 40
    assert {(view.width, view.height) for view in taken} == {(400, 300)}
    sight = np.array([view.rotation[2] for view in taken])
    angles = np.degrees(np.arccos(np.clip(sight @ sight.T, -1, 1))) + 180 * np.eye(len(taken))
    assert angles.min(1).max() < 12


def test_seed_decides_the_views():
    first, again, other = (
        np.array([view.centre for view in photos.views(seed)]) for seed in (3, 3, 4)
    )
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_scene_fills_every_view(gallery):
    for view in photos.views(0, WIDTH):
        along = view.rays((0.5, 0.5))
        hits = gallery.trace(np.float32([view.centre] * len(along)), along)
        assert np.all(hits.face >= 0)


def test_known_point_projects_to_the_pixel_whose_ray_hits_it(gallery):
    point = np.array([0.75, -0.75, 0.38])  # the middle of the front drum
    checked = 0
    for view in photos.views(0):
        pixel = view.project(point[None])[0]
        if not (0 <= pixel[0] < 400 and 0 <= pixel[1] < 300):
            continue
        column, row = np.floor(pixel).astype(int)
        along = view.rays(tuple(pixel - [column, row]))[row * 400 + column][None]
        hits = gallery.trace(np.float32(view.centre[None]), along)
        found = view.centre + hits.distance[0] * along[0]
        assert np.abs(found - point).max() <= 1e-3
        assert np.abs(hits.normal[0] - [0, 0, 1]).max() <= 1e-6
        checked += 1
    assert checked >= 20


def test_photo_is_the_same_every_time(gallery):
    import scene

    view = next(photos.views(0, WIDTH))
    first = gallery.render(view)
    assert first.shape == (30, WIDTH, 3)
    assert np.array_equal(first, scene.build().render(view))
    assert first.std() > 20
    assert np.mean((first == 0) | (first == 255)) < 0.02


@pytest.mark.slow
def test_files_are_plain_jpegs_and_the_same_from_any_process(gallery, monkeypatch, tmp_path):
    assert photos.make_photos(tmp_path / "pool", width=WIDTH, stops=2) == 2
    monkeypatch.setattr(photos, "_scene", lambda: gallery)
    for index, path in enumerate(sorted((tmp_path / "pool").iterdir())):
        again = tmp_path / f"{index}.jpg"
        photos.take(list(photos.views(0, WIDTH))[index], again)
        assert path.read_bytes() == again.read_bytes()
        with Image.open(path) as photo:
            assert (photo.format, photo.size) == ("JPEG", (WIDTH, 30))
            assert not photo.getexif()


def test_missing_tracer_is_one_clear_line(monkeypatch, tmp_path):
    monkeypatch.setattr(photos, "find_spec", lambda name: None)
    with pytest.raises(DataError, match=r"embreex .* pass a folder") as caught:
        photos.make_photos(tmp_path / "photos")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "photos").exists()
