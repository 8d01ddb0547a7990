"""Equirectangular photos and frames become pinhole views that show what they should."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from clgs.data.images import Pixels
from clgs.errors import DataError
from clgs.poses.bring_in import (
    DIRECTIONS,
    camera_numbers,
    cut,
    is_marked,
    readable_sizes,
    view_size,
)
from clgs.poses.find import find_photos
from tests.data.folders import write_video
from tests.poses.test_bring_in import brought

XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description '
    b'GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
)


def sphere(width: int) -> np.ndarray:
    """A photo (W / 2, W, 3) whose colors are directions: right, up, ahead from -1 to 1."""
    height = width // 2
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    latitude = (0.5 - (np.arange(height) + 0.5) / height) * np.pi
    longitude, latitude = np.meshgrid(longitude, latitude)
    level = np.cos(latitude)
    direction = level * np.sin(longitude), np.sin(latitude), level * np.cos(longitude)
    return np.rint(np.dstack(direction) * 127 + 127).astype(np.uint8)


def test_views_show_the_directions_that_they_are_for():
    width = 512
    views = list(cut(Pixels(sphere(width), None)))
    assert len(views) == len(DIRECTIONS)
    for (yaw, pitch), view in zip(DIRECTIONS, views, strict=True):
        size = view_size(width)
        assert view.size == (size, size)
        grid = (np.arange(size) + 0.5 - size / 2) / (size / 2)  # tan of half of 90 degrees is 1
        x, y = np.meshgrid(grid, grid)
        # a camera that is turned to the right, then up
        turned = Rotation.from_euler("YX", [yaw, -pitch], degrees=True).as_matrix()
        ray = np.stack([x, -y, np.ones_like(x)], axis=-1) @ turned.T
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        # half a level of rounding in the photo and in the view, and the bend of 127 cos within
        # a pixel of 0.0123 radians: 127 * 0.0123^2 / 8 per axis
        assert np.abs(view.color - (127 * ray + 127)).max() <= 1.02


def test_the_seam_of_a_photo_is_none_in_its_views():
    """The view behind shows the left and the right edge of the photo in its middle."""
    photo = np.zeros((64, 128, 3), np.uint8)
    photo[:, :, 0] = np.abs(np.arange(128) - 63.5).astype(np.uint8)
    behind = list(cut(Pixels(photo, None)))[3]
    middle = behind.color[20, 18:23, 0].astype(int)
    assert np.abs(np.diff(middle)).max() <= 3
    assert middle.min() >= 60


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(3):
        picture = np.roll(sphere(128), 5 * number, axis=1)
        Image.fromarray(picture).save(folder / f"{number}.jpg", quality=95, xmp=XMP)
    return folder


def test_marked_photos_are_cut_and_others_only_if_asked_for(photos: Path, tmp_path: Path):
    Image.fromarray(sphere(128)).save(photos / "wide.jpg")
    Image.fromarray(sphere(128)[:40]).save(photos / "crop.jpg", xmp=XMP)
    assert is_marked(photos / "0.jpg")
    assert not is_marked(photos / "wide.jpg")
    assert not is_marked(photos / "crop.jpg")
    found = brought(photos, tmp_path / "work")
    names = list(found)
    assert names[:4] == ["crop.jpg", "view00_0.jpg", "view00_1.jpg", "view00_2.jpg"]
    assert len(names) == 3 * len(DIRECTIONS) + 2
    views = [path for name, path in found.items() if name.startswith("view")]
    assert set(camera_numbers(views)) == {0}
    with Image.open(views[0]) as view:
        assert view.getexif().get_ifd(0x8769)[0xA405] == 18
    assert len(readable_sizes(find_photos(photos))) == 3 * len(DIRECTIONS) + 2


def test_all_photos_are_cut_if_that_is_asked_for(photos: Path, tmp_path: Path, caplog):
    Image.fromarray(sphere(128)).save(photos / "wide.png")
    Image.fromarray(sphere(128)[:50]).save(photos / "low.png")
    masks = photos / "masks"
    masks.mkdir()
    mask = np.full((64, 128), 255, np.uint8)
    mask[32:] = 0  # all below the horizon
    Image.fromarray(mask).save(masks / "0.png")
    work = tmp_path / "work"
    names = brought(photos, work, equirectangular=True)
    assert "low.jpg" not in names
    assert "is 128x50, and an equirectangular photo is twice as wide as high" in caplog.text
    assert len(names) == 4 * len(DIRECTIONS) - 3  # three of the views look at the masked half
    assert "view09_0.jpg" not in names
    level = np.asarray(Image.open(work / "masks" / "view00_0.jpg.png"))
    size = view_size(128)
    assert level[: size // 2 - 1].min() == 255
    assert level[size // 2 + 1 :].max() == 0
    assert not (work / "masks" / "view00_1.jpg.png").exists()


def test_frames_of_a_video_are_cut(tmp_path: Path):
    frames = [np.roll(sphere(128), 6 * number, axis=1) for number in range(10)]
    clip = write_video(tmp_path / "clip.mp4", frames, fps=5, macro_block_size=8)
    work = tmp_path / "work"
    names = list(brought(clip, work, 3, equirectangular=True))
    assert len(names) == 3 * len(DIRECTIONS)
    assert names[0] == "view00_frame_00001.jpg"
    assert not any((work / "frames").iterdir())


def test_a_video_that_is_none_of_the_sphere_is_refused(tmp_path: Path):
    frames = [np.roll(sphere(192), 9 * number, axis=1)[:64, :96] for number in range(6)]
    clip = write_video(tmp_path / "clip.mp4", frames, fps=5, macro_block_size=8)
    with pytest.raises(DataError, match="is 96x64, and an equirectangular photo is twice"):
        brought(clip, tmp_path / "work", 3, equirectangular=True)
