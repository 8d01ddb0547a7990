"""Masks: which pixels of a photo are used. White is used, black is not, as in COLMAP."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import (
    SUFFIXES,
    Pixels,
    box_downscale,
    image_size,
    list_images,
    open_image,
    read_image,
)
from clgs.data.reduction import IGNORE, OBJECT
from clgs.errors import DataError
from clgs.files import in_any_case

USED = 128
"""Masks and alpha channels at this level or above mean that the pixel is used."""

MASKS = "masks"
"""The folder of masks: NAME.png for the photo NAME, or NAME without its suffix."""

MASK_FOLDERS = (MASKS, "mask")
MASK_SUFFIXES = tuple(form(s) for form in (str.lower, str.upper) for s in (".png", *SUFFIXES))
MASK_MARKS = ("_mask", ".mask")
"""What the name of a mask may end in before its suffix; next to its photo it must."""

JUDGED = 16
"""The number of masks, evenly chosen, that say what masks mean; each is reduced to SMALL."""

SMALL = (64, 64)
MOST_BORDER, MOST_USED, LEAST_CHANGE = 0.25, 0.6, 0.01
"""Masks of an object leave at most these shares of a picture's border and of the whole of it, and
differ from photo to photo by at least the last, unlike those of a lens or a rig."""

Mask = npt.NDArray[np.uint8]
"""(H, W) uint8: 1 if the pixel is used, else 0."""


def find_mask(root: Path, photos: Path, name: str) -> Path | None:
    """The file of the mask of the photo called ``name``, if there is one.

    It is called as the photo is, with or without the suffix of the photo and one of MASK_MARKS. It
    lies in one of MASK_FOLDERS, of the data set or next to the photo; with a mark, also next to it.

    Args:
        root: folder of the data set.
        photos: folder of its photos, which the name is relative to.
        name: of the photo, with forward slashes.
    """
    names = tuple(dict.fromkeys((name, str(PurePosixPath(name).with_suffix("")))))
    below = [
        (folder, n.removeprefix("images/")) for folder in mask_folders(root, photos) for n in names
    ]
    own = (photos / name).parent
    below += [(own / folder, PurePosixPath(n).name) for folder in MASK_FOLDERS for n in names]
    paths = [
        folder / f"{each}{mark}{suffix}"
        for mark in ("", *MASK_MARKS)
        for suffix in MASK_SUFFIXES
        for folder, each in below
    ]
    paths += [
        photos / f"{each}{mark}{suffix}"
        for mark in MASK_MARKS
        for suffix in MASK_SUFFIXES
        for each in names
    ]
    for path in paths:
        with suppress(OSError):  # a name of a photo that leaves no room for a mark
            if path.is_file():
                return path
    return None


def mask_folders(root: Path, photos: Path) -> list[Path]:
    """List the MASK_FOLDERS that are in the data set ``root``, in its photos or next to them."""
    above = [] if photos == root else [photos.parent]
    places = dict.fromkeys([root, photos, *above, root / "images"])
    paths = (in_any_case(place / name) for place in places for name in MASK_FOLDERS)
    return [path for path in paths if path.is_dir()]


def list_masks(root: Path, photos: Path) -> list[Path]:
    """All files that seem to be masks of a data set; arguments as of :func:`find_mask`."""
    found = [path for folder in mask_folders(root, photos) for path in folder.rglob("*")]
    found += [path for path in list_images(photos) if path.stem.lower().endswith(MASK_MARKS)]
    images = (p for p in found if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    return sorted(set(images))


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


def meaning_of(masks: Sequence[Path | None]) -> str:
    """One of MEANINGS, by the masks of all photos, None for a photo without one.

    It is OBJECT if every photo has a mask and they usually leave something in the middle.

    Raises:
        DataError: a mask is damaged.
    """
    paths = [path for path in masks if path is not None]
    if not paths or len(paths) < len(masks):
        return IGNORE
    levels = []
    for number in np.linspace(0, len(paths) - 1, min(len(paths), JUDGED)).round().astype(int):
        with open_image(paths[number]) as picture:
            alpha = picture.convert("RGBA").split()[3] if picture.has_transparency_data else None
            level = picture if alpha is None or alpha.getextrema()[0] == 255 else alpha
            levels.append(np.asarray(level.convert("L").resize(SMALL)) >= USED)
    used = np.array(levels)
    border = np.concatenate([used[:, 0], used[:, -1], used[:, :, 0], used[:, :, -1]], axis=1)
    change = np.abs(np.diff(used.astype(float), axis=0)).mean() if len(used) > 1 else 1.0
    within = np.median(border.mean(axis=1)) <= MOST_BORDER
    part = np.median(used.mean(axis=(1, 2))) <= MOST_USED
    return OBJECT if within and part and change >= LEAST_CHANGE else IGNORE


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
