"""Pictures to an MP4 file, by ffmpeg as the package imageio-ffmpeg brings it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clgs.errors import ClgsError
from clgs.exports.image import Picture
from clgs.files import atomic_path, ffmpeg_closed
from clgs.shapes import Shapes

SUFFIX = ".mp4"

QUALITY = 18
"""H.264's constant rate factor: below 20 nobody sees a difference."""


@contextmanager
def mp4_writer(
    path: Path, size: tuple[int, int], fps: float
) -> Iterator[Callable[[Picture], None]]:
    """A new file at ``path``, whole or not at all.

    The block receives a function that adds a picture (H, W, 3) uint8. Width and height must be
    even, as the usual form of H.264 has them.

    Raises:
        ClgsError: imageio-ffmpeg is missing, or ffmpeg fails.
        ValueError: a size is odd, or a picture has another.
        OutputError, OSError: as of :func:`clgs.files.atomic_path`.
    """
    writer = load_writer()
    width, height = size
    if width % 2 or height % 2:
        raise ValueError(f"size: {width}x{height}, even numbers are needed")
    shapes = Shapes(H=height, W=width)
    with atomic_path(path) as temporary:
        sink = writer(
            str(temporary), size, fps=fps, codec="libx264", pix_fmt_out="yuv420p", quality=None,
            macro_block_size=1, ffmpeg_log_level="error",
            output_params=["-crf", str(QUALITY), "-movflags", "+faststart"],
        )  # fmt: skip
        with ffmpeg_closed(sink), _ffmpeg_named(path):
            sink.send(None)

            def add(picture: Picture) -> None:
                shapes.check("picture", picture, "H W 3", np.uint8)
                sink.send(np.ascontiguousarray(picture))

            yield add


@contextmanager
def _ffmpeg_named(path: Path) -> Iterator[None]:
    """Let an OSError be the ClgsError that says that ffmpeg failed at ``path``."""
    try:
        yield
    except OSError as error:
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ClgsError(f"{path}: ffmpeg failed: {first}") from error


def load_writer() -> Any:
    """imageio-ffmpeg's ``write_frames``; ClgsError if the package is missing."""
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise ClgsError(
            f'a video needs imageio-ffmpeg ({error}): pip install "clgs[video]", or name a folder '
            "for PNG files"
        ) from error
    return write_frames
