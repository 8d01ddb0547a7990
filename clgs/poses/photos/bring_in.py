"""Photos of any kind, or a video, to files that structure from motion reads best."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import (
    check_image,
    image_size,
    is_plain,
    open_image,
    read_exif,
    read_image,
)
from clgs.data.masks import MASKS, USED, Mask, read_mask, save_mask
from clgs.errors import DataError
from clgs.poses.photos.find import Collection, Found, find_photos, is_video
from clgs.poses.photos.video import check_video, extract_frames

LEAST_PHOTOS = 3
JPEG_QUALITY = 95
DEFAULT_FRAMES = 100
"""Of a video, unless another number is asked for."""

WRITTEN = (".jpg", ".jpeg", ".png")

_DETAILS = 0x8769
_CAMERA_TAGS = (0x010F, 0x0110)  # maker, model
_LENS_TAGS = (0x920A, 0xA405, 0xA20E, 0xA20F, 0xA210)
"""Focal length, the same on 35 mm film, pixels per unit of the sensor across and down, unit."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Source:
    """What a data set is to be made of: the photos that were found, or a video."""

    path: Path
    collection: Collection | None
    frames: int

    @property
    def files(self) -> list[Path]:
        """All files that are read."""
        return [one.path for one in self.collection.photos] if self.collection else [self.path]


def find_source(path: Path, frames: int | None = None) -> Source:
    """What there is at ``path``, a folder or a video; nothing is decoded, nothing written.

    Args:
        path: of the folder or the video.
        frames: of a video, to be used; default DEFAULT_FRAMES.

    Raises:
        DataError: nothing there, too few photos, or no program that reads videos.
    """
    if is_video(path):
        check_video(path)
        return Source(path, None, frames or DEFAULT_FRAMES)
    found = find_photos(path)
    if frames is not None:
        raise DataError(f"{path}: --frames is for videos; leave it out, or name a video")
    _check_enough(found)
    return Source(path, found, 0)


def readable_sizes(found: Collection) -> list[tuple[int, int]]:
    """Sizes (width, height) of the photos whose headers can be read; the others are skipped.

    Raises:
        DataError: fewer than 3 can be read, or no program that reads HEIC.
    """
    sizes: list[tuple[int, int]] = []

    def look(one: Found) -> None:
        sizes.append(image_size(one.path))

    _set_aside(found, [_fault(partial(look, one)) for one in found.photos])
    return sizes


def bring_in(
    source: Source, work: Path, on_read: Callable[[int], None] = lambda count: None
) -> list[tuple[int, int]]:
    """Fill ``work``/images, and ``work``/masks if photos are masked; a warning names what is not.

    Photos are whole, upright, 8-bit RGB or grey, with the EXIF data that they had. What is hidden
    by an alpha channel is black and masked. Masks are NAME.png for the photo NAME, as COLMAP reads
    them, and then all photos have one.

    Args:
        source: from :func:`find_source`.
        work: an empty folder.
        on_read: called with the number of photos that were read so far, or of a video's frames that
            were written.

    Returns:
        Sizes (width, height) of the photos in ``work``/images, in the order of their names.

    Raises:
        DataError: too few photos are whole.
    """
    images, masks = work / "images", work / MASKS
    images.mkdir()
    found = source.collection
    if found is None:
        extract_frames(source.path, images, source.frames, on_read)
        sizes = [image_size(path) for path in sorted(images.iterdir())]
        if len(sizes) < LEAST_PHOTOS:
            raise DataError(
                f"{source.path}: only {len(sizes)} of its frames can be used, at least 3 are "
                "needed; record a longer one"
            )
        return sizes
    masks.mkdir()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        written = []
        for error in pool.map(
            lambda one: _fault(partial(_write, one, images, masks)), found.photos
        ):
            written.append(error)
            on_read(len(written))
    _set_aside(found, written)
    for line in found.lines():
        _log.warning("%s", line)
    paths = sorted(images.iterdir())
    sizes = [image_size(path) for path in paths]
    _complete(masks, dict(zip((path.name for path in paths), sizes, strict=True)))
    return sizes


def _complete(masks: Path, sizes: dict[str, tuple[int, int]]) -> None:
    """White masks for the photos without one: COLMAP passes over them otherwise.

    If no photo has a mask the folder goes.
    """
    if not any(masks.iterdir()):
        masks.rmdir()
        return
    for name, (width, height) in sizes.items():
        if not (masks / f"{name}.png").exists():
            save_mask(np.ones((height, width), np.uint8), masks / f"{name}.png")


def _check_enough(found: Collection) -> None:
    if len(found.photos) < LEAST_PHOTOS:
        skipped = "".join(f"; {line.removeprefix(f'{found.root}: ')}" for line in found.lines())
        raise DataError(
            f"{found.root}: {len(found.photos)} photos that can be read (JPEG, PNG, WebP, HEIC); "
            f"at least {LEAST_PHOTOS} are needed{skipped}"
        )


def _set_aside(found: Collection, faults: list[str]) -> None:
    """Skip the photos with a fault; DataError if too few are left."""
    judged = list(zip(found.photos, faults, strict=True))
    for one, fault in judged:
        if fault:
            below = one.path.relative_to(found.root).as_posix()
            found.skipped.append((below, fault.removeprefix(f"{one.path}: ")))
    found.photos = [one for one, fault in judged if not fault]
    _check_enough(found)


def _fault(work: Callable[[], None]) -> str:
    """What is wrong with the photo that is read by ``work``, else an empty text."""
    try:
        work()
    except DataError as error:
        if "clgs[heif]" in str(error):  # the photo is whole, and a half of the set of no use
            raise
        return str(error)
    return ""


def _write(one: Found, images: Path, masks: Path) -> None:
    """Write a photo and its mask."""
    mask: Mask | None = None
    if is_plain(one.path):
        check_image(one.path)
        if one.mask:
            mask = read_mask(one.mask, image_size(one.path))
        copy = images / one.name
        shutil.copyfile(one.path, copy)
    else:
        pixels = read_image(one.path)
        color = pixels.color
        if one.mask:
            mask = read_mask(one.mask, pixels.size)
        if pixels.alpha is not None:
            seen = (pixels.alpha >= USED).astype(np.uint8)
            if not seen.any():
                raise DataError(f"{one.path}: is transparent everywhere; remove it")
            color, mask = color * seen[..., None], seen if mask is None else mask * seen
        copy = images / _suffixed(one)
        _save(color, one.path, copy)
    if mask is not None and not mask.all():
        save_mask(mask, masks / f"{copy.name}.png")


def _suffixed(one: Found) -> str:
    """The photo's name with the suffix of a format that it can be written in."""
    stem, _, suffix = one.name.rpartition(".")
    return one.name if f".{suffix.lower()}" in WRITTEN else f"{stem}.jpg"


def _save(color: npt.NDArray[np.uint8], original: Path, copy: Path) -> None:
    """Write pixels (H, W, 3) that are upright, with what the original says of its lens."""
    with open_image(original) as opened:
        exif = _lens_data(read_exif(opened))
    picture = Image.fromarray(color)
    if copy.suffix.lower() == ".png":
        picture.save(copy, "PNG", exif=exif, compress_level=1)
    else:
        picture.save(copy, "JPEG", exif=exif, quality=JPEG_QUALITY, subsampling=0)


def _lens_data(exif: Image.Exif) -> Image.Exif:
    """Camera and focal length alone: maker's notes may be longer than a JPEG's header."""
    kept, details = Image.Exif(), exif.get_ifd(_DETAILS)
    for tag in _CAMERA_TAGS:
        if tag in exif:
            kept[tag] = exif[tag]
    lens = {tag: details[tag] for tag in _LENS_TAGS if tag in details}
    if lens:
        kept.get_ifd(_DETAILS).update(lens)
    return kept
