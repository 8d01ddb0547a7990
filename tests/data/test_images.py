"""Reading of every accepted kind of image, refusal of the others, box means."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image, ImageOps

from clgs.data.images import (
    Pixels,
    box_downscale,
    check_image,
    exif_turn,
    image_size,
    is_plain,
    posed_size,
    read_image,
    scales_evenly,
)
from clgs.data.masks import USED, read_mask
from clgs.doctor.dataset import damaged
from clgs.errors import DataError
from tests.data.folders import noise_image, orientation


@pytest.mark.parametrize("mode", ["L", "P", "1", "LA", "RGB", "RGBA", "I;16", "CMYK"])
def test_modes_become_8_bit_rgb(tmp_path, mode):
    path = tmp_path / ("a.jpg" if mode == "CMYK" else "a.png")
    if mode == "I;16":
        image = Image.fromarray(np.full((4, 6), 40000, np.uint16))
    else:
        image = Image.new("RGB", (6, 4), (204, 204, 204)).convert(mode)
    image.save(path)
    pixels = read_image(path)
    assert pixels.color.shape == (4, 6, 3)
    assert pixels.color.dtype == np.uint8
    assert pixels.alpha is None
    expected = {"I;16": round(40000 / 257)}.get(mode, 204)
    if mode == "1":
        assert set(np.unique(pixels.color)) <= {0, 255}
    else:
        assert np.abs(pixels.color.astype(int) - expected).max() <= 2


def test_alpha_is_kept(tmp_path):
    rgba = np.dstack([noise_image(5, 4), np.arange(20, dtype=np.uint8).reshape(4, 5)])
    Image.fromarray(rgba).save(tmp_path / "a.png")
    pixels = read_image(tmp_path / "a.png")
    assert np.array_equal(pixels.alpha, rgba[..., 3])
    assert np.array_equal(pixels.color, rgba[..., :3])


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_exif_rotation(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    stored = np.zeros((16, 32, 3), np.uint8)
    stored[:, :16] = 255
    Image.fromarray(stored).save(path, exif=orientation(6))
    assert image_size(path) == (16, 32)
    upright = read_image(path)
    assert upright.size == (16, 32)
    assert upright.color[:8].mean() >= 250
    assert upright.color[-8:].mean() <= 5


@pytest.mark.parametrize("tag", range(1, 9))
@pytest.mark.parametrize("size", [(32, 16), (16, 16)])
def test_a_pose_decides_about_the_exif_rotation(tmp_path, tag, size):
    """Only pixels that fit no other way are turned; a pose may be for the photo at full size."""
    path, (width, height), stored = tmp_path / "a.png", size, noise_image(*size)
    Image.fromarray(stored).save(path, exif=orientation(tag))
    turned = np.asarray(ImageOps.exif_transpose(Image.open(path)))
    for times in (1, 3):
        for expected in ((width * times, height * times), (height * times, width * times)):
            fits = tag < 5 or scales_evenly(size, expected)
            right = stored if fits else turned
            assert posed_size(path, expected) == right.shape[1::-1]
            assert np.array_equal(read_image(path, expected).color, right)
            assert exif_turn(path, expected) == (tag > 1, not fits)
    assert posed_size(path, None) == size
    mask = read_mask(path, size)
    assert np.array_equal(mask, stored.mean(axis=2) >= USED)
    upright = read_mask(path, turned.shape[1::-1], posed=False)
    assert np.array_equal(upright, turned.mean(axis=2) >= USED)


@pytest.mark.parametrize("suffix", ["jpg", "png"])
@pytest.mark.parametrize("exif", [b"garbage", b"Exif\0\0garbage", b"Exif\0\0II*\0\xff\xff\xff\xff"])
def test_damaged_exif_does_not_spoil_the_pixels(tmp_path, suffix, exif):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(noise_image(16, 8)).save(path, exif=exif)
    assert image_size(path) == (16, 8)
    assert is_plain(path)
    with Image.open(path) as picture:
        assert np.array_equal(read_image(path).color, np.asarray(picture))


@pytest.mark.parametrize("tag", [(1, 2), 0, 9])
def test_an_orientation_that_there_is_not_is_none(tmp_path, tag):
    Image.fromarray(noise_image(16, 8)).save(tmp_path / "a.png", exif=orientation(tag))
    assert np.array_equal(read_image(tmp_path / "a.png").color, noise_image(16, 8))


def test_truncated_image_names_the_file(tmp_path):
    for suffix in ("jpg", "png"):
        path = tmp_path / f"cut.{suffix}"
        Image.fromarray(noise_image(64, 64)).save(path)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(DataError, match=rf"cut\.{suffix}: damaged"):
            read_image(path)


def png(mode: int, size: tuple[int, int], rows: bytes, interlaced: int = 0) -> bytes:
    """A PNG whose chunks are whole, regardless of how many ``rows`` it has."""
    header = struct.pack(">II5B", *size, 8, mode, 0, 0, interlaced)
    whole = b"\x89PNG\r\n\x1a\n"
    for kind, data in ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")):
        checksum = zlib.crc32(kind + data)
        whole += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)
    return whole


@pytest.mark.parametrize(
    ("mode", "interlaced", "rows"),
    [
        (0, 0, 6 * (1 + 5)),
        (6, 0, 6 * (1 + 20)),
        # passes of 1x1, 1x1, 2x1, 1x2, 3x1, 2x3 and 5x3 pixels
        (0, 1, 2 + 2 + 3 + 2 * 2 + 4 + 3 * 3 + 3 * 6),
    ],
)
def test_pixels_that_a_png_lacks_are_found(tmp_path, mode, interlaced, rows):
    """Pillow takes most of them for black."""
    path = tmp_path / "a.png"
    path.write_bytes(png(mode, (5, 6), bytes(rows), interlaced))
    check_image(path)
    path.write_bytes(png(mode, (5, 6), bytes(rows - 1), interlaced))
    with pytest.raises(DataError, match=r"a\.png: damaged image \(pixels are missing at its end\)"):
        check_image(path)
    assert "pixels are missing" in str(damaged([path])[0])


def test_other_formats_and_text_are_refused(tmp_path):
    Image.fromarray(noise_image(8, 8)).save(tmp_path / "a.bmp")
    (tmp_path / "a.bmp").rename(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(b"")
    for name in ("a.png", "b.png"):
        with pytest.raises(DataError, match="not a JPEG, PNG or WebP"):
            read_image(tmp_path / name)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("side", [12_000, 18_000])  # Pillow itself refuses the second
def test_bomb_is_refused_from_its_header(tmp_path, side):
    (tmp_path / "bomb.png").write_bytes(png(2, (side, side), b""))
    with pytest.raises(DataError, match="limit of 100 megapixels; downscale the image first"):
        image_size(tmp_path / "bomb.png")


def test_box_means_of_whole_boxes():
    color = noise_image(12, 8)
    small = box_downscale(Pixels(color, None), 4)
    expected = np.rint(color.reshape(2, 4, 3, 4, 3).mean(axis=(1, 3)))
    assert np.abs(small.color - expected).max() <= 1
    assert small.size == (3, 2)


@pytest.mark.parametrize("size", [(41, 31), (497, 372), (17, 3), (1, 1)])
@pytest.mark.parametrize("factor", [2, 3, 8])
def test_box_keeps_linear_ramps(size, factor):
    """The mean of a ramp over a box is the ramp at the box's middle: no shift at odd sizes."""
    width, height = size
    ramp = (np.arange(width) + 0.5) / width * 255
    color = np.broadcast_to(np.rint(ramp)[None, :, None], (height, width, 3)).astype(np.uint8)
    small = box_downscale(Pixels(color, None), factor)
    assert small.size == (max(1, round(width / factor)), max(1, round(height / factor)))
    middle = (np.arange(small.size[0]) + 0.5) / small.size[0] * 255
    # A pixel is flat where the ramp is not: the part of a cut pixel is off by up to an eighth step.
    assert np.abs(small.color[0, :, 0] - middle).max() <= 1.01 + 255 / width / 8


def test_box_weighs_color_by_alpha():
    color = np.zeros((2, 2, 3), np.uint8)
    color[0, 0] = 200
    alpha = np.array([[100, 0], [0, 0]], np.uint8)
    small = box_downscale(Pixels(color, alpha), 2)
    assert small.color.tolist() == [[[200, 200, 200]]]
    assert small.alpha.tolist() == [[25]]
