"""Videos: what is written comes back; nothing half-written stays."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.exports.pictures import mp4_writer

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
    assert len(frames) == 12
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
