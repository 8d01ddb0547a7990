"""Masks: which pixels of a photo are used. White is used, black is not, as in COLMAP."""

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

MASKS = "masks"
"""The folder of masks: NAME.png for the photo NAME, or NAME without its suffix."""

Mask = npt.NDArray[np.uint8]
"""(H, W) uint8: 1 if the pixel is used, else 0."""


def mask_names(photo: str) -> tuple[str, str]:
    """The names that the mask of a photo may have, without .png."""
    return photo, photo.rpartition(".")[0]


def find_mask(root: Path, photo: str) -> Path | None:
    """The file of the mask of a photo in the folder MASKS of a data set, if there is one."""
    paths = (root / MASKS / f"{name}.png" for name in mask_names(photo))
    return next((path for path in paths if path.is_file()), None)


def read_mask(path: Path, size: tuple[int, int], posed: bool = True) -> Mask:
    """The mask in a file for a photo of ``size`` (width, height).

    The alpha of a picture is its mask; without alpha it is the mean of the colors. The mask of a
    photo that has no pose yet (``posed``) is turned upright as the photo is.

    Raises:
        DataError: damaged, of another size, or it leaves no pixel.
    """
    found = image_size(path)
    pixels = read_image(path, size if posed or found != size else None)
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
    """The pixels of a resampled mask that only used pixels went into.

    pixels: a mask of 0 and 255 as its only channel of color.
    """
    return np.asarray(pixels.color[..., 0] == 255).astype(np.uint8)


class StoredMask:
    """The mask of a view, at its size; read when it is first asked for, then kept as bits."""

    def __init__(self, read: Callable[[], Pixels]) -> None:
        """``read`` gives the mask as 0 and 255 in one channel, resampled as the photo is."""
        self._read = read
        self._kept: dict[int, tuple[tuple[int, ...], npt.NDArray[np.uint8]]] = {}

    def used(self, factor: int = 1) -> Mask:
        """The mask ``factor`` times smaller: the pixels that only used ones went into.

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
