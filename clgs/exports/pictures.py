"""Pictures for people: PNG files, error maps, comparison strips, MP4 files.

Pictures are (H, W, 3) uint8 sRGB throughout. Videos are written by ffmpeg as the package
imageio-ffmpeg brings it.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError
from clgs.files import atomic_path
from clgs.machine import ffmpeg_closed
from clgs.shapes import Shapes

Picture = npt.NDArray[np.uint8]

ERROR_GAIN = 4.0
"""Errors are shown this many times larger: the map is saturated at 255 / 4 = 64 levels."""

GAP = 4
"""White pixels between the pictures of a strip or sheet."""

HEAT_STOPS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
HEAT_COLORS = np.array(
    [(8, 6, 24), (62, 18, 110), (146, 38, 128), (222, 73, 104), (254, 159, 109), (252, 253, 191)],
    dtype=np.float64,
)
"""Black over violet and orange to cream: lightness grows evenly, so it reads in grey as well."""

COMPRESSION = 4
"""The level of PNG: it takes half the time of Pillow's own level, 6, for 2 % more bytes."""


def save_png(path: str | Path, picture: Picture) -> None:
    """Write ``picture`` (H, W, 3) uint8 to ``path``: the whole file or none.

    Raises:
        ValueError, TypeError: it is no picture.
        OSError: it cannot be written.
    """
    from PIL import Image

    Shapes().check("picture", picture, "H W 3", np.uint8)
    with atomic_path(Path(path)) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG", compress_level=COMPRESSION)


def jpeg_bytes(picture: Picture, quality: int = 92) -> bytes:
    """``picture`` (H, W, 3) uint8 as a JPEG file without chroma subsampling, for embedding."""
    from PIL import Image

    Shapes().check("picture", picture, "H W 3", np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="JPEG", quality=quality, subsampling=0)
    return buffer.getvalue()


def heat(value: npt.NDArray[np.float64]) -> Picture:
    """Colours (H, W, 3) of values (H, W), 0 dark to 1 light; values outside are clipped."""
    channels = [np.interp(value, HEAT_STOPS, channel) for channel in HEAT_COLORS.T]
    picture: Picture = np.rint(np.stack(channels, -1)).astype(np.uint8)
    return picture


def error_map(photo: Picture, render: Picture) -> Picture:
    """Mean absolute difference over the channels, ERROR_GAIN times magnified, as heat.

    Raises:
        ValueError: the pictures differ in size.
    """
    shapes = Shapes()
    shapes.check("photo", photo, "H W 3", np.uint8)
    shapes.check("render", render, "H W 3", np.uint8)
    difference = np.abs(photo.astype(np.float64) - render).mean(axis=-1)
    return heat(difference * (ERROR_GAIN / 255))


def comparison(photo: Picture, render: Picture) -> Picture:
    """The strip photo | render | error, (H, 3 W + 2 GAP, 3).

    Raises:
        ValueError: the pictures differ in size.
    """
    return sheet([photo, render, error_map(photo, render)], columns=3)


def sheet(pictures: Sequence[Picture], columns: int) -> Picture:
    """Pictures in rows of ``columns`` on white; cells are as large as the largest picture."""
    if not pictures:
        raise ValueError("no pictures to lay out")
    height = max(picture.shape[0] for picture in pictures) + GAP
    width = max(picture.shape[1] for picture in pictures) + GAP
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    page = np.full((rows * height - GAP, columns * width - GAP, 3), 255, np.uint8)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        top, left = row * height, column * width
        page[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return page


def picture_names(names: Sequence[str]) -> list[str]:
    """File names (.png), all different, for photos called ``names``.

    The stem of a photo's name if all stems differ, else its path with "_" for separators.
    Characters outside of letters, digits, ".", "-" and "_" become "_".
    """
    stems = [PurePosixPath(name.replace("\\", "/")).with_suffix("") for name in names]
    for form in ("name", "path", "numbered"):
        chosen = (stem.name if form == "name" else str(stem) for stem in stems)
        plain = [re.sub(r"[^\w.-]", "_", text.strip("./")) for text in chosen]
        if form == "numbered":
            plain = [f"{name}_{number}" for number, name in enumerate(plain)]
        if len({name.casefold() for name in plain}) == len(plain):
            break
    return [f"{name}.png" for name in plain]


class PictureFolder:
    """Renders and photos as PNG files in the layout that the tools of the 3DGS family read."""

    def __init__(self, run: Path, steps: int, names: Sequence[str]) -> None:
        """Make the folders in ``run``, after ``steps`` steps; ``names`` of all views."""
        self._run, self._folder = run, run / "test" / f"ours_{steps}"
        self._files = dict(zip(names, picture_names(names), strict=True))
        for kind in ("renders", "gt"):
            (self._folder / kind).mkdir(parents=True, exist_ok=True)

    def add(self, name: str, render: Picture, photo: Picture) -> None:
        """Write the pictures of the view ``name``; those of the first view are also the preview."""
        file = self._files[name]
        save_png(self._folder / "renders" / file, render)
        save_png(self._folder / "gt" / file, photo)
        if file == next(iter(self._files.values())):
            save_png(self._run / "preview.png", comparison(photo, render))


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
