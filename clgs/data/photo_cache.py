"""Large photos as they are used, kept in the user's cache folder: decoding them takes long.

Points of photos are kept there, too (:mod:`clgs.poses.triangulate`).

A file's name follows from everything that its pixels depend on, the contents of the photo included.
Files that are damaged are made again; the oldest go if all take more than LIMIT bytes.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import PIL
from PIL import Image

from clgs.data.images import Pixels, check_image, read_image
from clgs.errors import ClgsError
from clgs.files import atomic_write, cache_folder, make_folder

FOLDER = "photos"

LEAST_PIXELS, LEAST_REDUCTION = 4_000_000, 4
"""Photos of fewer pixels, or of which more than a fourth stay, are decoded every time."""

LIMIT = 2**30
"""Bytes of all files together."""

VERSION = "1"
"""Another one if photos are reduced or undistorted in another way."""


def is_worth_keeping(before: tuple[int, int], after: tuple[int, int]) -> bool:
    """Whether a photo that is reduced from one size (width, height) to another is kept."""
    pixels = before[0] * before[1]
    return pixels >= max(LEAST_PIXELS, LEAST_REDUCTION * after[0] * after[1])


def kept_pixels(files: list[Path], settings: object, make: Callable[[], Pixels]) -> Pixels:
    """What ``make`` gives, from the cache if it is there.

    Args:
        files: that the pixels are made of.
        settings: how they are made; its ``repr`` says all that matters.
        make: decodes and reduces a photo.

    Raises:
        DataError: as of ``make``. A cache that cannot be read or written is no error.
    """
    key = hashlib.blake2b(f"{VERSION} {PIL.__version__} {settings!r}".encode(), digest_size=20)
    try:
        for file in files:
            key.update(hashlib.blake2b(file.read_bytes()).digest())
    except OSError:
        return make()  # which says what is wrong
    kept = cache_folder() / FOLDER / f"{key.hexdigest()}.png"
    with suppress(ClgsError, OSError):
        check_image(kept)
        found = read_image(kept)
        os.utime(kept)
        return found
    pixels, buffer = make(), io.BytesIO()
    if pixels.alpha is not None and pixels.alpha.min() == 255:
        return pixels  # it would come back without alpha
    layers = [pixels.color] if pixels.alpha is None else [pixels.color, pixels.alpha[..., None]]
    Image.fromarray(np.concatenate(layers, axis=2)).save(buffer, "PNG", compress_level=1)
    with suppress(ClgsError, OSError):
        make_folder(kept.parent)
        atomic_write(kept, buffer.getvalue())
        forget_oldest(kept.parent)
    return pixels


def forget_oldest(folder: Path) -> None:
    """Remove the files that were not used for longest, until the others take at most LIMIT."""
    files = sorted((file.stat().st_mtime, file.stat().st_size, file) for file in folder.iterdir())
    excess = sum(size for _, size, _ in files) - LIMIT
    for _, size, file in files:
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size
