"""Frames of videos that the test makes: sharp, evenly spread, and what is no video."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import uniform_filter

from clgs.errors import DataError
from clgs.poses.bring_in import find_source
from clgs.poses.video import extract_frames, frame_size, sharpness
from tests.data.folders import noise_image, write_noise, write_video

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")

SIZE = 96, 64
RATE = 10


def frame(number: int, blurred: bool) -> np.ndarray:
    """Blocks of noise whose left edge tells the number."""
    blocks = noise_image(SIZE[0] // 4, SIZE[1] // 4, number).repeat(4, 0).repeat(4, 1)
    picture = uniform_filter(blocks, (9, 9, 0)) if blurred else blocks
    picture[:, :16] = 4 * number
    return picture


def number_of(path: Path) -> int:
    return round(float(np.asarray(Image.open(path).convert("L"))[:, 2:12].mean()) / 4)


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    """Six seconds; every fourth frame is sharp: 1, 5, 9 and so on."""
    frames = [frame(number, number % 4 != 1) for number in range(60)]
    path = tmp_path_factory.mktemp("video") / "clip one.mp4"
    return write_video(path, frames, fps=RATE, quality=9, macro_block_size=1)


def test_a_sharp_frame_of_every_span(clip: Path, tmp_path: Path):
    seen: list[int] = []
    assert extract_frames(clip, tmp_path, 10, seen.append) == 10
    assert seen == list(range(1, 11))
    files = sorted(tmp_path.iterdir())
    assert files[0].name == "frame_00001.jpg"
    numbers = [number_of(path) for path in files]
    assert [number // 6 for number in numbers] == list(range(10))
    assert all(number % 4 == 1 for number in numbers)
    assert all(Image.open(path).size == SIZE for path in files)


def test_an_upright_phone_video_gives_upright_frames(clip: Path, tmp_path: Path, caplog):
    turned = tmp_path / "turned.mp4"
    program, copied = imageio_ffmpeg.get_ffmpeg_exe(), ["-i", str(clip), "-c", "copy"]
    words = [program, "-v", "error", "-display_rotation", "90", *copied, str(turned)]
    subprocess.run(words, check=True, timeout=60)
    (tmp_path / "frames").mkdir()
    assert extract_frames(turned, tmp_path / "frames", 3) == 3
    assert frame_size(turned) == SIZE[::-1]
    for path in (tmp_path / "frames").iterdir():
        picture = Image.open(path)
        assert picture.size == SIZE[::-1]
        even = np.asarray(picture.convert("L"))[-14:-4].std()  # the left edge, turned to the left
        assert even < 4
    assert not caplog.records


def test_the_same_frames_again(clip: Path, tmp_path: Path):
    found = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        extract_frames(clip, tmp_path / name, 7)
        found.append([path.read_bytes() for path in sorted((tmp_path / name).iterdir())])
    assert found[0] == found[1]


def test_no_more_frames_than_there_are(clip: Path, tmp_path: Path):
    assert extract_frames(clip, tmp_path, 1000) == 60
    numbers = [number_of(path) for path in sorted(tmp_path.iterdir())]
    assert numbers == sorted(set(numbers))


def test_a_truncated_video_gives_what_is_whole(clip: Path, tmp_path: Path):
    frames = [frame(number, False) for number in range(60)]
    path = write_video(tmp_path / "cut.mkv", frames, fps=RATE, macro_block_size=1)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (tmp_path / "frames").mkdir()
    with pytest.warns(UserWarning, match=r"ends after \d\.\d of the 6\.\d seconds"):
        assert 2 <= extract_frames(path, tmp_path / "frames", 10) < 10


def test_frames_that_stand_still_are_left_out(tmp_path: Path):
    frames = [frame(min(number, 8), True) for number in range(20)]
    path = write_video(tmp_path / "frozen.mkv", frames, fps=RATE, codec="ffv1")
    (tmp_path / "frames").mkdir()
    seen: list[int] = []
    with pytest.warns(UserWarning, match="11 of its frames are equal to the one before"):
        assert extract_frames(path, tmp_path / "frames", 20, seen.append) == 9
    assert seen == list(range(1, 10))
    assert len(list((tmp_path / "frames").iterdir())) == 9


@pytest.mark.parametrize("content", [b"", b"no video", b"#EXTM3U\n#EXTINF:1,\n/etc/passwd\n"])
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "-i clip.mp4"
    path.write_bytes(content)
    with pytest.raises(DataError, match="is no video"):
        extract_frames(path, tmp_path, 5)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_sound_alone_is_no_video(tmp_path: Path):
    import wave

    path = tmp_path / "sound.mp4"
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(16000))
    with pytest.raises(DataError, match="is no video"):
        extract_frames(path, tmp_path, 5)


def test_the_library_is_asked_for_in_one_line(clip: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # its import fails
    with pytest.raises(DataError, match=r'imageio-ffmpeg; pip install "clgs\[video\]"'):
        find_source(clip)


def test_frames_are_of_videos_alone(tmp_path: Path, clip: Path):
    with pytest.raises(DataError, match="--frames is for videos"):
        find_source(write_noise(tmp_path), 20)
    assert find_source(clip, 20).frames == 20
    assert find_source(clip).frames == 100


def test_sharpness_falls_with_blur():
    sharp = noise_image(200, 100, 1)
    assert sharpness(sharp) > 10 * sharpness(uniform_filter(sharp, (5, 5, 0)))
    assert sharpness(noise_image(2, 2)) == 0
    assert sharpness(noise_image(3000, 40)) > 0
