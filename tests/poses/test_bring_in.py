"""Photos of any kind become what structure from motion reads; damaged ones are named."""

import logging
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.data.images import read_image
from clgs.errors import DataError
from clgs.poses.bring_in import bring_in, camera_numbers, find_source
from tests.data.folders import noise_image, room_image, room_poses, write_noise

DETAILS, ORIENTATION = 0x8769, 0x0112


def brought(
    source: Path, work: Path, frames: int | None = None, equirectangular: bool = False
) -> dict[str, Path]:
    """Bring photos or ``frames`` of a video in; returns the files by name, in order."""
    work.mkdir()
    bring_in(find_source(source, frames), work, equirectangular=equirectangular)
    return {path.name: path for path in sorted((work / "images").iterdir())}


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """A folder with three plain photos."""
    return write_noise(tmp_path / "photos", 3, (32, 24), "jpg")


def smooth() -> Image.Image:
    """A picture that survives compression: 64x48, four colors."""
    array = np.zeros((48, 64, 3), np.uint8)
    array[:24, :32], array[:24, 32:], array[24:, :32] = (250, 10, 10), (10, 250, 10), (10, 10, 250)
    return Image.fromarray(array)


def test_plain_photos_keep_their_bytes(photos: Path, tmp_path: Path):
    found = brought(photos, tmp_path / "work")
    assert [path.read_bytes() for path in found.values()] == [
        (photos / name).read_bytes() for name in found
    ]
    assert not (tmp_path / "work" / "masks").exists()


def test_every_kind_becomes_upright_8_bit_rgb(photos: Path, tmp_path: Path):
    picture, exif = smooth(), Image.Exif()
    exif[ORIENTATION] = 6
    picture.transpose(Image.Transpose.ROTATE_90).save(photos / "turned.jpg", exif=exif, quality=95)
    picture.convert("CMYK").save(photos / "cmyk.jpg", quality=95)
    picture.save(photos / "web.webp", quality=95)
    picture.quantize(8).save(photos / "palette.png")
    picture.save(photos / "lies.jpg", "PNG")
    grey = np.asarray(picture.convert("L"), np.uint16) * 257
    Image.fromarray(grey).save(photos / "deep.png")
    picture.convert("L").save(photos / "grey.jpg", quality=95)
    found = brought(photos, tmp_path / "work")
    assert len(found) == 10
    wanted = np.asarray(picture, np.int64)
    for name in ("turned.jpg", "cmyk.jpg", "web.jpg", "palette.png", "lies.jpg"):
        with Image.open(found[name]) as opened:
            assert (opened.mode, opened.size) == ("RGB", (64, 48)), name
            assert opened.format == ("PNG" if name.endswith("png") else "JPEG")
            assert np.abs(np.asarray(opened, np.int64) - wanted).mean() < 8, name
    level = np.asarray(picture.convert("L"), np.int64)
    for name in ("deep.png", "grey.jpg"):
        assert np.abs(read_image(found[name]).color[..., 0].astype(int) - level).mean() < 4, name


def test_heic_is_read_with_its_focal_length(photos: Path, tmp_path: Path):
    pillow_heif = pytest.importorskip("pillow_heif", reason="pillow-heif is not installed")
    pillow_heif.register_heif_opener()
    exif = Image.Exif()
    exif[ORIENTATION], exif.get_ifd(DETAILS)[0xA405] = 6, 26
    turned = smooth().transpose(Image.Transpose.ROTATE_90)
    # as phones do: the rotation stands in the container, too
    turned.save(photos / "IMG_1.HEIC", quality=90, exif=exif.tobytes())
    found = brought(photos, tmp_path / "work")
    with Image.open(found["IMG_1.jpg"]) as opened:
        assert opened.size == (64, 48)
        assert opened.getexif().get(ORIENTATION, 1) == 1
        assert opened.getexif().get_ifd(DETAILS)[0xA405] == 26
        error = np.abs(np.asarray(opened, np.int64) - np.asarray(smooth(), np.int64))
    assert error.mean() < 8
    whole = (photos / "IMG_1.HEIC").read_bytes()
    (photos / "IMG_2.HEIC").write_bytes(whole[: len(whole) // 2])
    (photos / "IMG_3.heic").write_bytes(b"no image")
    assert set(brought(photos, tmp_path / "again")) == {"0.jpg", "1.jpg", "2.jpg", "IMG_1.jpg"}


def test_without_its_library_heic_ends_in_one_line(photos: Path, tmp_path: Path, monkeypatch):
    (photos / "IMG_1.HEIC").write_bytes(b"any bytes")
    monkeypatch.setitem(sys.modules, "pillow_heif", None)  # its import fails
    with pytest.raises(DataError, match=r'IMG_1\.HEIC: HEIC needs .* "clgs\[heif\]"'):
        brought(photos, tmp_path / "work")


def test_damaged_photos_are_skipped_and_named(photos: Path, tmp_path: Path, caplog):
    whole = (photos / "0.jpg").read_bytes()
    (photos / "empty.jpg").touch()
    (photos / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    Image.fromarray(noise_image(64, 64)).save(photos / "cut.png")
    (photos / "cut.png").write_bytes((photos / "cut.png").read_bytes()[:4000])
    (photos / "text.jpg").write_bytes(b"no image")
    with caplog.at_level(logging.WARNING):
        found = brought(photos, tmp_path / "work")
    assert list(found) == ["0.jpg", "1.jpg", "2.jpg"]
    for name in ("empty.jpg", "cut.jpg", "cut.png", "text.jpg"):
        assert name in caplog.text
    for name in found:
        (photos / name).unlink()
    with pytest.raises(DataError, match=r"0 photos .* at least 3 are needed; skipped .*text\.jpg"):
        brought(photos, tmp_path / "again")


def test_alpha_becomes_a_mask_and_what_it_hides_is_black(photos: Path, tmp_path: Path):
    rgba = np.dstack([noise_image(32, 24, 5) | 1, np.full((24, 32), 255, np.uint8)])
    rgba[:, :16, 3], rgba[:, 16, 3] = 0, 127
    Image.fromarray(rgba).save(photos / "alpha.png")
    Image.fromarray(rgba).save(photos / "lossless.webp", lossless=True)
    found = brought(photos, tmp_path / "work")
    masks = {path.name: path for path in (tmp_path / "work" / "masks").iterdir()}
    assert set(masks) == {"alpha.png.png", "lossless.jpg.png"}
    for name in ("alpha.png.png", "lossless.jpg.png"):
        level = np.asarray(Image.open(masks[name]))
        assert (level[:, :17] == 0).all()
        assert (level[:, 17:] == 255).all()
    color = read_image(found["alpha.png"]).color
    assert not color[:, :17].any()
    assert np.array_equal(color[:, 17:], rgba[:, 17:, :3])


def test_masks_of_files_and_of_alpha_are_joined(photos: Path, tmp_path: Path, caplog):
    rgba = np.dstack([noise_image(32, 24, 5), np.full((24, 32), 255, np.uint8)])
    rgba[:12, :, 3] = 0
    Image.fromarray(rgba).save(photos / "alpha.png")
    (photos / "masks").mkdir()
    mask = np.zeros((24, 32), np.uint8)
    mask[:, 8:] = 255
    for name in ("0.png", "alpha.png"):
        Image.fromarray(mask).save(photos / "masks" / name)
    Image.fromarray(mask[:5]).save(photos / "masks" / "1.png")
    Image.fromarray(mask * 0).save(photos / "masks" / "2.jpg.png")
    Image.fromarray(noise_image(32, 24, 9)).save(photos / "3.jpg")
    Image.fromarray(np.full((24, 32), 255, np.uint8)).save(photos / "masks" / "3.png")
    found = brought(photos, tmp_path / "work")
    assert set(found) == {"0.jpg", "3.jpg", "alpha.png"}
    assert "1.jpg" in caplog.text
    assert "make it as large as the photo" in caplog.text
    assert "the mask is black" in caplog.text
    masks = tmp_path / "work" / "masks"
    assert np.array_equal(np.asarray(Image.open(masks / "0.jpg.png")), mask)
    assert not (masks / "3.jpg.png").exists()  # nothing is masked
    joined = np.asarray(Image.open(masks / "alpha.png.png")) // 255
    assert np.array_equal(joined, (mask // 255) * (rgba[..., 3] // 255))


def test_cameras_are_told_apart_by_size_model_and_focal_length(tmp_path: Path):
    paths, same = [], ((8, 6), "A", 26)
    others = ((6, 8), "A", 26), ((8, 6), "B", 26), ((8, 6), "A", 52)
    for number, (size, model, focal) in enumerate([same, same, *others]):
        exif = Image.Exif()
        exif[0x0110], exif.get_ifd(DETAILS)[0xA405] = model, focal
        paths.append(tmp_path / f"{number}.jpg")
        Image.fromarray(noise_image(*size, number)).save(paths[-1], exif=exif)
    assert camera_numbers(paths) == [0, 0, 1, 2, 3]


@pytest.mark.slow
def test_masked_photos_are_posed_and_their_masks_kept(tmp_path: Path):
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    from clgs.data.dataset import load_dataset
    from clgs.poses.prepare import prepare

    photos = tmp_path / "photos"
    photos.mkdir()
    for number, pose in enumerate(room_poses(7)):
        color = room_image(pose, (320, 240), 320.0)
        alpha = np.full((240, 320), 255, np.uint8)
        # the same text in every photo, fixed to the picture: its features would spoil the poses
        color[180:, :] = noise_image(320, 60, 3)
        alpha[180:, :] = 0
        Image.fromarray(np.dstack([color, alpha])).save(photos / f"{number}.png")
    summary = prepare(photos, tmp_path / "data")
    assert summary.registered == 7
    data = load_dataset(tmp_path / "data")
    for view in data.train + data.test:
        used = view.used()
        assert used.shape == (view.camera.height, view.camera.width)
        assert not used[-50:].any()
        assert used[20:160, 20:-20].all()
    assert len(data.points) > 100
