"""Masks: which pixels of a photo are of use. White is used, black is not, as in COLMAP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import Pixels, box_downscale, image_size, read_image
from clgs.errors import DataError

USED = 128
"""Masks and alpha channels at this level or above mean that the pixel is used."""

Mask = npt.NDArray[np.uint8]
"""(H, W) uint8: 1 where the pixel is used, else 0."""


def read_mask(path: Path, size: tuple[int, int]) -> Mask:
    """The mask in a file for a photo of ``size`` (width, height).

    Of a picture with alpha that is the mask, else its mean level.

    Raises:
        DataError: damaged, of another size, or it leaves no pixel.
    """
    found = image_size(path)
    pixels = read_image(path, size)
    if pixels.size != size:
        raise DataError(
            f"{path}: the mask is {found[0]}x{found[1]}, its photo {size[0]}x{size[1]}; make it "
            "as large as the photo"
        )
    level = pixels.color.mean(axis=2) if pixels.alpha is None else pixels.alpha
    used = (level >= USED).astype(np.uint8)
    if not used.any():
        raise DataError(f"{path}: the mask is black, so nothing of the photo is left; correct it")
    return used


def save_mask(mask: Mask, path: Path) -> None:
    """Write a mask as a grey PNG of 0 and 255."""
    Image.fromarray(mask * np.uint8(255)).save(path, "PNG", compress_level=1)


def whole(pixels: Pixels) -> Mask:
    """The pixels that hold nothing but used ones of the photo that ``pixels`` came from.

    pixels: a mask of 0 and 255 as its only channel of color, after any resampling.
    """
    return np.asarray(pixels.color[..., 0] == 255).astype(np.uint8)


class StoredMask:
    """The mask of a view, at its size; read when it is first asked for, then kept as bits."""

    def __init__(self, read: Callable[[], Pixels]) -> None:
        """``read`` gives the mask as 0 and 255 in one channel, resampled as the photo is."""
        self._read = read
        self._kept: dict[int, tuple[tuple[int, ...], npt.NDArray[np.uint8]]] = {}

    def used(self, factor: int = 1) -> Mask:
        """The mask ``factor`` times smaller: pixels that hold nothing but used ones.

        Raises:
            DataError: it is damaged.
        """
        if factor not in self._kept:
            mask = whole(self._read())
            if factor > 1:
                mask = whole(box_downscale(Pixels(mask[..., None] * np.uint8(255), None), factor))
            self._kept[factor] = mask.shape, np.packbits(mask)
        shape, bits = self._kept[factor]
        return np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape)
