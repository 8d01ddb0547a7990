"""Sharp frames of a video, evenly spread.

The program ffmpeg, which the package imageio-ffmpeg ships, decodes up to CANDIDATES frames per
wanted frame, at even times. The sharpest near the middle of each span of time is written, so that
the times between neighbours are nearly equal.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import MAX_PIXELS
from clgs.errors import DataError
from clgs.machine import ffmpeg_closed

CANDIDATES = 8
"""Frames from which one is chosen, if the video has enough."""

MIDDLE = 0.75
"""Share of a span of time from which its frame is chosen."""

MEASURED_SIZE = 960
"""Frames are reduced to about this width before sharpness is measured: noise is not sharpness."""

WHOLE = 0.95
"""A warning says so if a video ends before this share of its length."""

JPEG_QUALITY = 95
"""Photos and frames are written with this quality."""

_ONLY_FILES = ["-protocol_whitelist", "file", "-nostdin"]
"""A video may name other files, even in the network; ffmpeg must not open them."""


def video_library(path: Path) -> Any:
    """Import the library that decodes the video ``path``; DataError if it is not installed."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise DataError(
            f'{path}: videos need imageio-ffmpeg; pip install "clgs[video]", or give a folder of '
            "photos"
        ) from error
    logging.getLogger("imageio_ffmpeg").setLevel(logging.ERROR)  # it warns of every turned video
    return imageio_ffmpeg


def extract_frames(
    path: Path, folder: Path, count: int, on_frame: Callable[[int], None] = lambda done: None
) -> int:
    """Write ``count`` frames, or as many as there are, to ``folder`` as JPEG, in order.

    The rotation that the video asks for is applied. ``on_frame`` receives the number of frames
    written so far; that of all is returned.

    Raises:
        DataError: no video, a damaged one, or no program that reads it.
    """
    seconds, rate = _seconds_and_rate(path)
    candidates = min(seconds * rate, CANDIDATES * count)
    best: tuple[float, npt.NDArray[np.uint8]] | None = None
    writer = _Writer(folder, on_frame)
    number = current = 0
    for number, frame in enumerate(_frames(path, candidates / seconds)):
        place = (number + 0.5) / candidates * count
        if int(place) != current and best is not None:
            writer.write(best[1])
            best = None
        current = int(place)
        if current >= count:
            break
        if candidates > 2 * count and abs(place % 1 - 0.5) > MIDDLE / 2:
            continue
        measured = sharpness(frame)
        if best is None or measured > best[0]:
            best = measured, frame
    if best is not None:
        writer.write(best[1])
    if not writer.written:
        raise DataError(f"{path}: no frame can be decoded; is it a whole video? record it again")
    share = (number + 1) / candidates
    if share < WHOLE - 1 / candidates:
        _warn(
            f"{path}: ends after {share * seconds:.1f} of the {seconds:.1f} seconds that it should "
            "have, as if cut short; copy it again if you need the rest"
        )
    if writer.equal:
        _warn(
            f"{path}: {writer.equal} of its frames are equal to the one before and are left out; "
            "it stood still, or is damaged"
        )
    return writer.written


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=3)


def sharpness(frame: npt.NDArray[np.uint8]) -> float:
    """Compute the variance of the Laplacian of the reduced green of a frame (H, W, 3) uint8."""
    factor = max(1, round(frame.shape[1] / MEASURED_SIZE))
    height, width = (size // factor for size in frame.shape[:2])
    green = frame[: height * factor, : width * factor, 1].astype(np.float32)
    if factor > 1:
        green = green.reshape(height, factor, width, factor).mean(axis=(1, 3))
    laplacian = green[:-2, 1:-1] + green[2:, 1:-1] + green[1:-1, :-2] + green[1:-1, 2:]
    laplacian -= 4 * green[1:-1, 1:-1]
    return float(laplacian.var(dtype=np.float64)) if laplacian.size else 0.0


def _seconds_and_rate(path: Path) -> tuple[float, float]:
    """Read the length of a video in seconds, and its frames per second.

    Raises:
        DataError: it has neither, or is too large.
    """
    library = video_library(path)
    with _whole(path):
        facts = _facts(path)
        rate, seconds = float(facts.get("fps") or 0), float(facts.get("duration") or 0)
        width, height = facts["source_size"]
        if not (0 < rate < 1e5 and math.isfinite(seconds) and seconds > 0):
            total, seconds = library.count_frames_and_secs(_named(path))
            rate = total / seconds if seconds else 0.0
        if not (seconds > 0 and 0 < rate < 1e5):
            raise ValueError("neither length nor rate")
    if width * height > MAX_PIXELS:
        raise DataError(f"{path}: frames of {width}x{height} pixels are too large; scale it down")
    return seconds, rate


def frame_size(path: Path) -> tuple[int, int]:
    """Read width and height of a video's frames, after the rotation that it asks for.

    Raises:
        DataError: it is damaged, or there is no program that reads videos.
    """
    with _whole(path):
        width, height = _facts(path)["size"]
        return int(width), int(height)


def _facts(path: Path) -> dict[str, Any]:
    reader = video_library(path).read_frames(_named(path), input_params=_ONLY_FILES)
    with ffmpeg_closed(reader):
        facts: dict[str, Any] = next(reader)
    return facts


def _frames(path: Path, rate: float) -> Iterator[npt.NDArray[np.uint8]]:
    """Decode frames (H, W, 3) uint8, ``rate`` per second, as long as the video is whole."""
    output = ["-vf", f"fps={rate:.9g}", "-fps_mode", "passthrough"]
    reader = video_library(path).read_frames(
        _named(path), pix_fmt="rgb24", input_params=_ONLY_FILES, output_params=output
    )
    with ffmpeg_closed(reader), _whole(path):
        width, height = next(reader)["size"]
        for data in reader:
            yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


def _named(path: Path) -> str:
    """Make a name that ffmpeg always takes for a file."""
    return f"file:{path.absolute()}"


@contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Let everything that fails while a video is read be a DataError."""
    try:
        yield
    except (OSError, RuntimeError, ValueError, KeyError, StopIteration) as error:
        raise DataError(
            f"{path}: is no video that ffmpeg reads, or a damaged one; record it again"
        ) from error


class _Writer:
    """Writes the frames that differ from the one before; counts these, and the equal ones."""

    def __init__(self, folder: Path, on_frame: Callable[[int], None]) -> None:
        self.written = self.equal = 0
        self._folder, self._on_frame = folder, on_frame
        self._last: npt.NDArray[np.uint8] | None = None

    def write(self, frame: npt.NDArray[np.uint8]) -> None:
        if self._last is not None and np.array_equal(frame, self._last):
            self.equal += 1
            return
        self._last = frame
        self.written += 1
        path = self._folder / f"frame_{self.written:05d}.jpg"
        Image.fromarray(frame).save(path, "JPEG", quality=JPEG_QUALITY, subsampling=0)
        self._on_frame(self.written)
