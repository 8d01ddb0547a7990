"""Pictures and videos: what is written comes back; nothing half-written stays."""

import numpy as np
import pytest
from PIL import Image

from clgs.exports.pictures import (
    ERROR_GAIN,
    GAP,
    comparison,
    error_map,
    heat,
    jpeg_bytes,
    mp4_writer,
    picture_names,
    save_png,
    sheet,
)

RNG = np.random.default_rng(5)
PICTURE = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)


def test_png_keeps_every_pixel(tmp_path):
    save_png(tmp_path / "picture.png", PICTURE)
    with Image.open(tmp_path / "picture.png") as read:
        assert read.format == "PNG"
        assert np.array_equal(np.array(read), PICTURE)
    assert [path.name for path in tmp_path.iterdir()] == ["picture.png"]


@pytest.mark.parametrize("wrong", [PICTURE[..., 0], PICTURE.astype(np.float32), PICTURE[..., :2]])
def test_what_is_no_picture_is_refused_and_nothing_written(tmp_path, wrong):
    with pytest.raises((ValueError, TypeError), match="picture"):
        save_png(tmp_path / "picture.png", wrong)
    assert not list(tmp_path.iterdir())


def test_jpeg_is_close_to_the_picture():
    import io

    smooth = np.tile(np.arange(0, 240, 10, dtype=np.uint8)[None, :, None], (16, 1, 3))
    read = np.array(Image.open(io.BytesIO(jpeg_bytes(smooth))))
    assert read.shape == smooth.shape
    assert np.abs(read.astype(int) - smooth).max() <= 6


def test_heat_grows_lighter_and_clips():
    ramp = heat(np.linspace(0, 1, 64)[None])
    lightness = ramp.astype(float) @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(lightness) > 0)
    assert np.array_equal(heat(np.array([[-3.0, 7.0]])), ramp[:, [0, -1]])


def test_error_map_is_dark_where_equal_and_saturates():
    photo = np.minimum(PICTURE, 100)
    render = photo.copy()
    render[2, 3] += np.uint8(np.ceil(255 / ERROR_GAIN))
    found = error_map(photo, render)
    assert np.array_equal(found[2, 3], heat(np.ones((1, 1)))[0, 0])
    found[2, 3] = found[0, 0]
    assert np.array_equal(found, np.tile(heat(np.zeros((1, 1))), (5, 7, 1)))


def test_error_map_is_symmetric():
    other = RNG.integers(0, 256, PICTURE.shape, dtype=np.uint8)
    assert np.array_equal(error_map(PICTURE, other), error_map(other, PICTURE))


def test_comparison_lines_up_photo_render_error():
    other = RNG.integers(0, 256, PICTURE.shape, dtype=np.uint8)
    strip = comparison(PICTURE, other)
    assert strip.shape == (5, 3 * 7 + 2 * GAP, 3)
    parts = [strip[:, start : start + 7] for start in (0, 7 + GAP, 2 * (7 + GAP))]
    assert np.array_equal(parts[0], PICTURE)
    assert np.array_equal(parts[1], other)
    assert np.array_equal(parts[2], error_map(PICTURE, other))


def test_comparison_of_different_sizes_is_refused():
    with pytest.raises(ValueError, match="render: shape"):
        comparison(PICTURE, PICTURE[:, 1:])


def test_sheet_lays_out_rows():
    small = PICTURE[:3, :4]
    page = sheet([PICTURE, small, small], columns=2)
    assert page.shape == (2 * 5 + GAP, 2 * 7 + GAP, 3)
    assert np.array_equal(page[5 + GAP : 8 + GAP, :4], small)
    assert np.all(page[5 + GAP :, 7 + GAP :] == 255)


def test_sheet_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no pictures"):
        sheet([], columns=2)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["train/r_0.png", "b/r 1?.JPG"], ["r_0.png", "r_1_.png"]),
        (["a/1.jpg", "b/1.jpg"], ["a_1.png", "b_1.png"]),
        (["a\\1.jpg", "b\\1.jpg"], ["a_1.png", "b_1.png"]),
        (["1.jpg", "1.png"], ["1_0.png", "1_1.png"]),
        (["a.jpg", "x/A.jpg"], ["a.png", "x_A.png"]),
    ],
)
def test_every_photo_gets_its_own_file(names, expected):
    assert picture_names(names) == expected


imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs clgs[video]")


def pictures(count, size=(32, 48)):
    """Smooth pictures that change, (H, W, 3) uint8."""
    y, x = np.mgrid[: size[0], : size[1]]
    for number in range(count):
        planes = [3 * x + 10 * number, 4 * y, np.full_like(x, 128)]
        yield np.clip(np.stack(planes, -1), 0, 255).astype(np.uint8)


def test_frames_come_back(tmp_path):
    path = tmp_path / "clip.mp4"
    with mp4_writer(path, (48, 32), 25.0) as add:
        for picture in pictures(12):
            add(picture)
    reader = imageio_ffmpeg.read_frames(str(path))
    facts = next(reader)
    assert facts["size"] == (48, 32)
    assert facts["fps"] == 25
    frames = [np.frombuffer(frame, np.uint8).reshape(32, 48, 3) for frame in reader]
    for mine, theirs in zip(frames, pictures(12), strict=True):
        error = np.mean((mine.astype(float) - theirs) ** 2)
        assert 10 * np.log10(255**2 / error) > 28  # 4:2:0 halves the resolution of color
    assert [p.name for p in tmp_path.iterdir()] == ["clip.mp4"]


def test_a_failure_leaves_nothing(tmp_path):
    path = tmp_path / "clip.mp4"
    with pytest.raises(ValueError, match="picture"), mp4_writer(path, (48, 32), 25.0) as add:
        add(next(pictures(1, (32, 46))))
    with pytest.raises(ValueError, match="even"), mp4_writer(path, (47, 32), 25.0):
        pass
    assert not list(tmp_path.iterdir())
