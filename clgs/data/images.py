"""Photos on disk to 8-bit arrays: checked before decoding, upright, box-downscaled."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from clgs.errors import DataError

if TYPE_CHECKING:
    from scipy import sparse

FORMATS = ("JPEG", "PNG", "WEBP")
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
HEIF_SUFFIXES = (".heic", ".heif", ".hif")
"""Read by pillow-heif, which is an extra."""

MAX_PIXELS = 100_000_000
"""Larger images are refused before they are decoded."""

PLAIN_SUFFIXES = {"JPEG": (".jpg", ".jpeg"), "PNG": (".png",)}
"""The suffixes by which other programs know a format."""

ASPECT_TOLERANCE = 1.5
"""Pixels by which an image may differ from its declared size scaled evenly (sizes are rounded)."""

_BAND_COLUMNS = 64
"""Columns that are averaged at a time."""

_ORIENTATION = 0x0112
_TRANSPOSED = (5, 6, 7, 8)
_ROTATIONS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
_FAILURES = (OSError, SyntaxError, ValueError, EOFError, RuntimeError, LookupError, zlib.error)

_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Numbers per pixel by the kind of color."""

_PNG_PASSES = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4)),
    *((0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)
"""First column and row of the seven passes of an interlaced picture, and the steps of both."""


@dataclass(frozen=True)
class Pixels:
    """color (H, W, 3) uint8 RGB; alpha (H, W) uint8 or None for an opaque image."""

    color: npt.NDArray[np.uint8]
    alpha: npt.NDArray[np.uint8] | None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.color.shape[1], self.color.shape[0]

    @property
    def channels(self) -> npt.NDArray[np.uint8]:
        """Color, and alpha if there is any, (H, W, 3 or 4)."""
        return self.color if self.alpha is None else np.dstack([self.color, self.alpha])

    @classmethod
    def of(cls, channels: npt.NDArray[np.uint8]) -> Pixels:
        """The pixels whose ``channels`` these are; a single one is that of a mask."""
        alpha = np.ascontiguousarray(channels[..., 3]) if channels.shape[2] == 4 else None
        return cls(np.ascontiguousarray(channels[..., :3]), alpha)


def list_images(folder: Path) -> list[Path]:
    """Photos directly in ``folder`` by their suffixes, sorted by name."""
    known = SUFFIXES + HEIF_SUFFIXES
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in known and p.is_file())


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) after the EXIF rotation, from the header alone.

    Raises:
        DataError: the file is of another format, or larger than MAX_PIXELS.
    """
    with open_image(path) as picture:
        return upright_size(picture)


def read_image(path: Path, expected: tuple[int, int] | None = None) -> Pixels:
    """The image as 8-bit RGB with its alpha, EXIF rotation applied.

    If ``expected`` (width, height) is given, the image has a pose for pixels of that size. Then
    it is only turned if its stored size does not fit and its turned size does.

    Raises:
        DataError: of another format, larger than MAX_PIXELS, truncated or damaged.
    """
    with open_image(path) as picture:
        rotate = expected is None or _must_turn(picture, expected)
        operation = _ROTATIONS.get(_orientation(picture)) if rotate else None
        picture.load()
        return _to_8_bit(picture if operation is None else picture.transpose(operation))


def is_plain(path: Path) -> bool:
    """Whether the file is an upright 8-bit JPEG or PNG already, RGB or grey, named as one."""
    with open_image(path) as picture:
        deep = any("16" in str(tile[3]) for tile in getattr(picture, "tile", ()))
        return (
            path.suffix.lower() in PLAIN_SUFFIXES.get(picture.format or "", ())
            and _orientation(picture) == 1
            and picture.mode in ("RGB", "L")
            and not deep
            and not picture.has_transparency_data
        )


def check_image(path: Path) -> None:
    """Check that a photo is whole, in a fraction of the time of :func:`read_image`.

    Raises:
        DataError: as there; wrong pixels within a whole file are not found.
    """
    check_chunks(path)
    with open_image(path) as picture:
        picture.draft("L", (1, 1))  # of a JPEG an eighth of the resolution is decoded
        picture.load()


def check_chunks(path: Path) -> None:
    """Check what Pillow does not when it reads a PNG: checksums, and that no pixel is missing.

    Missing ones would be black. Other formats are left alone.

    Raises:
        DataError: a checksum is wrong, or pixels are missing.
    """
    with open_image(path) as picture:
        if picture.format != "PNG":
            return
        picture.verify()
        width, height, depth, kind, interlaced = struct.unpack(
            ">II2B2xB", _png_chunk(path, b"IHDR")
        )
        bits = depth * _PNG_CHANNELS[kind]
        passes = _PNG_PASSES if interlaced else ((0, 0, 1, 1),)
        sizes = ((-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in passes)
        left = sum(rows * (1 + -(-columns * bits // 8)) for columns, rows in sizes if columns > 0)
        inflater = zlib.decompressobj()
        data = _png_chunk(path, b"IDAT")
        while left > 0 and (found := inflater.decompress(data, 1 << 20)):
            left, data = left - len(found), inflater.unconsumed_tail
        if left > 0:
            raise OSError("pixels are missing at its end")


def _png_chunk(path: Path, wanted: bytes) -> bytes:
    """What all chunks of one kind hold, in a PNG file whose chunks are whole."""
    data, place, found = path.read_bytes(), len(_PNG_START), []
    while place < len(data):
        size, kind = struct.unpack_from(">I4s", data, place)
        if kind == wanted:
            found.append(data[place + 8 : place + 8 + size])
        place += 12 + size
    return b"".join(found)


def posed_size(path: Path, expected: tuple[int, int] | None) -> tuple[int, int]:
    """(width, height) of an image that has a pose for pixels of the ``expected`` size.

    It is read from the header alone. Without an expected size the image stays as it is stored.
    """
    with open_image(path) as picture:
        turned = expected is not None and _must_turn(picture, expected)
        return upright_size(picture) if turned else picture.size


def exif_turn(path: Path, expected: tuple[int, int]) -> tuple[bool, bool]:
    """Whether EXIF data say that an image with a pose is not upright, and whether it is turned."""
    with open_image(path) as picture:
        return _orientation(picture) in _ROTATIONS, _must_turn(picture, expected)


def scales_evenly(size: tuple[int, int], expected: tuple[int, int]) -> bool:
    """Whether two sizes (width, height) have one aspect ratio, but for rounding to pixels."""
    scale = max(size[0] / expected[0], size[1] / expected[1])
    excess = max(abs(b * scale - a) for a, b in zip(size, expected, strict=True))
    return excess <= ASPECT_TOLERANCE


def box_downscale(pixels: Pixels, factor: int) -> Pixels:
    """The photo ``factor`` times smaller; sizes are rounded, see :func:`box_resized`."""
    width, height = (max(1, round(size / factor)) for size in pixels.size)
    return box_resized(pixels, width, height)


def box_resized(pixels: Pixels, width: int, height: int) -> Pixels:
    """Each output pixel is the mean of its box of input pixels; at most as large as the input.

    Boxes have fractional edges if a size is no multiple of the new one, so nothing is cropped and
    nothing is shifted. Color is averaged premultiplied by alpha.
    """
    if pixels.size == (width, height):
        return pixels
    if pixels.alpha is None:
        return Pixels(_to_uint8(_box(pixels.color, None, height, width)), None)
    mean_alpha = _box(pixels.alpha[..., None], None, height, width)
    mean_color = _box(pixels.color, pixels.alpha, height, width)
    color = mean_color / np.maximum(mean_alpha, 1e-3)
    return Pixels(_to_uint8(color), _to_uint8(mean_alpha)[..., 0])


def _too_large(path: Path, pixels: str) -> str:
    limit = f"{MAX_PIXELS // 10**6} megapixels"
    return f"{path}: {pixels} exceed the limit of {limit}; downscale the image first"


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """An image whose header has been checked; every failure of Pillow becomes a DataError."""
    try:
        with Image.open(path, formats=_formats(path)) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise DataError(_too_large(path, f"{picture.width}x{picture.height} pixels"))
            yield picture
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; put it back") from None
    except Image.DecompressionBombError:  # Pillow's own limit, before the size is known here
        raise DataError(_too_large(path, "its pixels")) from None
    except UnidentifiedImageError:
        raise DataError(f"{path}: not a JPEG, PNG or WebP image; convert or remove it") from None
    except _FAILURES as error:
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(f"{path}: damaged image ({said}); replace it") from error


def _formats(path: Path) -> tuple[str, ...]:
    """The formats that a file may have."""
    if path.suffix.lower() not in HEIF_SUFFIXES:
        return FORMATS
    try:
        from pillow_heif import register_heif_opener
    except ImportError as error:
        raise DataError(
            f'{path}: HEIC needs pillow-heif; pip install "clgs[heif]", or convert it to JPEG'
        ) from error
    register_heif_opener()
    return (*FORMATS, "HEIF")


def read_exif(picture: Image.Image) -> Image.Exif:
    """The EXIF data that precedes the pixels in the file; empty if it is damaged.

    Pillow's getexif would decode a whole PNG.
    """
    exif = Image.Exif()
    try:
        exif.load(picture.info.get("exif", b""))
        int(exif.get(_ORIENTATION, 1))
    except (*_FAILURES, struct.error, TypeError, LookupError, ArithmeticError):
        return Image.Exif()
    return exif


def _orientation(picture: Image.Image) -> int:
    return int(read_exif(picture).get(_ORIENTATION, 1))


def upright_size(picture: Image.Image) -> tuple[int, int]:
    """(width, height) of an opened picture after the EXIF rotation."""
    transposed = _orientation(picture) in _TRANSPOSED
    return (picture.height, picture.width) if transposed else picture.size


def _must_turn(picture: Image.Image, expected: tuple[int, int]) -> bool:
    """Whether only the turned pixels fit a pose for pixels of the ``expected`` size."""
    upright = upright_size(picture)
    return not scales_evenly(picture.size, expected) and scales_evenly(upright, expected)


def _to_8_bit(image: Image.Image) -> Pixels:
    """Any mode of Pillow to RGB and alpha; 16-bit grey is divided by 257, not clipped."""
    if image.mode.startswith("I") or image.mode == "F":
        grey = np.asarray(image, np.float64)
        image = Image.fromarray(_to_uint8(grey / 257.0))
    if image.has_transparency_data:
        rgba = np.asarray(image.convert("RGBA"))
        return Pixels.of(rgba[..., :3] if rgba[..., 3].min() == 255 else rgba)
    return Pixels(np.array(image.convert("RGB")), None)


def _to_uint8(values: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    return np.ascontiguousarray(np.clip(np.rint(values), 0, 255), np.uint8)


def _box(
    values: npt.NDArray[np.uint8],
    weight: npt.NDArray[np.uint8] | None,
    height: int,
    width: int,
) -> npt.NDArray[np.float32]:
    """Area means of values (H, W, C), times weight (H, W) if given, on a (height, width) grid.

    Bands of columns are averaged one after the other, so that few pixels are floats at a time.
    """
    rows, columns, channels = values.shape
    weights = _box_weights(rows, height)
    down = np.empty((height, columns, channels), np.float32)
    for start in range(0, columns, _BAND_COLUMNS):
        part = slice(start, start + _BAND_COLUMNS)
        band = values[:, part].astype(np.float32)
        if weight is not None:
            band *= weight[:, part, None]
        down[:, part] = (weights @ band.reshape(rows, -1)).reshape(height, -1, channels)
    across = down.transpose(1, 0, 2).reshape(columns, -1)
    mean = _box_weights(columns, width) @ across
    return np.asarray(mean.reshape(width, height, channels).transpose(1, 0, 2))


def _box_weights(inputs: int, outputs: int) -> sparse.csr_array:
    """(outputs, inputs) float32: the share of each input pixel in each output pixel's box."""
    from scipy import sparse  # takes a third of the time of `clgs info` to load

    edges = np.arange(outputs + 1) * (inputs / outputs)
    cuts = np.union1d(np.arange(inputs + 1), edges)
    # An edge a rounding error away from a pixel border cuts off nothing.
    cuts = cuts[np.concatenate([[True], np.diff(cuts) > 1e-9])]
    middle = (cuts[:-1] + cuts[1:]) / 2
    row = np.minimum((middle * (outputs / inputs)).astype(np.int64), outputs - 1)
    column = np.minimum(middle.astype(np.int64), inputs - 1)
    weight = (np.diff(cuts) * (outputs / inputs)).astype(np.float32)
    return sparse.csr_array((weight, (row, column)), shape=(outputs, inputs))
