"""Photos of any kind, or a video, to files that structure from motion reads best.

Equirectangular photos are cut into pinhole views, which structure from motion and training read.
Column and row of such a photo are longitude and latitude; its middle is ahead. Each view shows VIEW
degrees across and down, and has the photo's resolution in its middle.
"""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Container, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import (
    Pixels,
    check_chunks,
    check_image,
    image_size,
    is_plain,
    open_image,
    read_exif,
    read_image,
    upright_size,
)
from clgs.data.lens import resample
from clgs.data.masks import MASKS, USED, Mask, read_mask, save_mask, whole
from clgs.errors import DataError
from clgs.poses.find import Collection, Found, find_photos, is_video
from clgs.poses.gps import GPS
from clgs.poses.video import JPEG_QUALITY, extract_frames, video_library

VIEW = 90.0
DIRECTIONS = (
    *((60.0 * number, 0.0) for number in range(6)),
    *((30.0 + 120.0 * number, 45.0) for number in range(3)),
    *((90.0 + 120.0 * number, -45.0) for number in range(3)),
)
"""Degrees to the right and up of each view. Level neighbours share a third of what they show."""

FOCAL_35MM = 18
"""The focal length of VIEW on film of 35 mm, which is 36 mm wide."""

MARKS = b"ProjectionType", b"equirectangular"
"""What the XMP data of a photo hold if it says what it is (Google's Photo Sphere, GPano)."""


def is_marked(path: Path) -> bool:
    """Whether a photo is twice as wide as high, and its XMP data call it equirectangular.

    Raises:
        DataError: it cannot be read.
    """
    with open_image(path) as picture:
        if picture.width != 2 * picture.height:
            return False
        known = (picture.info.get(name, b"") for name in ("xmp", "XML:com.adobe.xmp"))
        data = b"".join(one.encode() if isinstance(one, str) else bytes(one) for one in known)
        return all(mark in data for mark in MARKS)


def view_size(width: int) -> int:
    """Pixels of the edge of a view of a photo that is ``width`` pixels wide."""
    return max(1, round(width / np.pi))


def cut(pixels: Pixels) -> Iterator[Pixels]:
    """The views of a photo in the order of DIRECTIONS, bilinear; alpha as color."""
    channels = pixels.channels
    height, width = channels.shape[:2]
    around = np.concatenate([channels[:, -1:], channels, channels[:, :1]], axis=1)
    size = view_size(width)
    grid = (np.arange(size) + 0.5) / size * 2 - 1
    grid *= np.tan(np.radians(VIEW / 2))
    right, down = (axis.ravel() for axis in np.meshgrid(grid, grid))
    for yaw, pitch in DIRECTIONS:
        sin, cos = np.sin(np.radians(pitch)), np.cos(np.radians(pitch))
        ahead, up = cos + sin * down, sin - cos * down
        longitude = np.arctan2(right, ahead) + np.radians(yaw)
        latitude = np.arctan2(up, np.hypot(right, ahead))
        column = np.mod(longitude / (2 * np.pi) + 0.5, 1.0) * width + 0.5
        row = np.clip((0.5 - latitude / np.pi) * height - 0.5, 0, height - 1)
        corner = np.minimum(column.astype(np.int32), width), row.astype(np.int32)
        corner = corner[0], np.minimum(corner[1], max(height - 2, 0))
        index = corner[1] * np.int32(width + 2) + corner[0]
        weight = np.stack([column - corner[0], row - corner[1]], axis=1).astype(np.float32)
        yield Pixels.of(resample(around, index, weight).reshape(size, size, -1))


LEAST_PHOTOS = 3
DEFAULT_FRAMES = 100
"""Frames that are taken from a video."""

WRITTEN = (".jpg", ".jpeg", ".png")

_DETAILS = 0x8769
_CAMERA_TAGS = (0x010F, 0x0110)  # maker, model
_FOCAL_35MM = 0xA405
_FOCAL_TAGS = (0x920A, _FOCAL_35MM)  # focal length in mm, and its equivalent on 35 mm film
_LENS_TAGS = (*_FOCAL_TAGS, 0xA20E, 0xA20F, 0xA210)
"""Also the pixels per unit of the sensor, across and down, and the unit."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PhotoSource:
    """The photos of a folder, or a video of which ``frames`` frames are taken."""

    path: Path
    collection: Collection | None
    frames: int

    @property
    def files(self) -> list[Path]:
        """All files to read."""
        return [one.path for one in self.collection.photos] if self.collection else [self.path]

    @property
    def masks(self) -> list[Path]:
        """The files of masks."""
        return [one.mask for one in self.collection.photos if one.mask] if self.collection else []


def find_source(path: Path, frames: int | None = None, least: int = LEAST_PHOTOS) -> PhotoSource:
    """Look at ``path``, a folder or a video; nothing is decoded, and nothing is written.

    ``frames``: how many to take from a video; default DEFAULT_FRAMES. ``least``: photos of a
    folder.

    Raises:
        DataError: nothing there, too few photos, or no program that reads videos.
    """
    if is_video(path):
        video_library(path)
        return PhotoSource(path, None, frames or DEFAULT_FRAMES)
    found = find_photos(path)
    if frames is not None:
        raise DataError(f"{path}: --frames is for videos; leave it out, or name a video")
    _check_enough(found, least)
    return PhotoSource(path, found, 0)


def readable_sizes(found: Collection) -> list[tuple[int, int]]:
    """Read the sizes (width, height) of photos from their headers; damaged ones are skipped.

    Of equirectangular photos they are those of all views.

    Raises:
        DataError: fewer than 3 can be read, or no program that reads HEIC.
    """
    sizes: list[tuple[int, int]] = []

    def look(one: Found) -> None:
        size = image_size(one.path)
        edge = view_size(size[0])
        sizes.extend([(edge, edge)] * len(DIRECTIONS) if is_marked(one.path) else [size])

    _set_aside(found, [_fault(partial(look, one)) for one in found.photos])
    return sizes


def bring_in(
    source: PhotoSource,
    work: Path,
    on_read: Callable[[int], None] = lambda count: None,
    equirectangular: bool = False,
) -> None:
    """Fill ``work``/images, and ``work``/masks if photos are masked; warn about skipped files.

    Photos are whole, upright, 8-bit RGB or grey, with the EXIF data that they had. What an alpha
    channel hides is black and masked. The mask of the photo NAME is NAME.png. Photos that say that
    they are equirectangular are cut into views, and so are all photos and frames if
    ``equirectangular``.

    ``work`` is an empty folder. ``on_read`` is called with the number of photos that were read so
    far, or of frames that were written.

    Raises:
        DataError: too few photos are whole.
    """
    images, masks = work / "images", work / MASKS
    images.mkdir()
    found = source.collection
    if found is None:
        folder = work / "frames" if equirectangular else images
        folder.mkdir(exist_ok=True)
        count = extract_frames(source.path, folder, source.frames, on_read)
        if count < LEAST_PHOTOS:
            raise DataError(
                f"{source.path}: only {count} of its frames can be used, at least 3 are "
                "needed; record a longer one"
            )
        for frame in sorted(folder.iterdir()) if equirectangular else ():
            _write_views(Found(frame, frame.name, frame.name), images, masks)
            frame.unlink()
        return
    masks.mkdir()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        written = []
        for error in pool.map(
            lambda one: _fault(partial(_write, one, images, masks, equirectangular)), found.photos
        ):
            written.append(error)
            on_read(len(written))
    _set_aside(found, written)
    for line in found.lines():
        _log.warning("%s", line)
    if not any(masks.iterdir()):
        masks.rmdir()


def _check_enough(found: Collection, least: int = LEAST_PHOTOS) -> None:
    if len(found.photos) < least:
        skipped = "".join(f"; {line.removeprefix(f'{found.root}: ')}" for line in found.lines())
        raise DataError(
            f"{found.root}: {len(found.photos)} photo{'s' * (len(found.photos) != 1)} that can be "
            "read (JPEG, PNG, WebP, HEIC); "
            f"at least {least} {'is' if least == 1 else 'are'} needed{skipped}"
        )


def _set_aside(found: Collection, faults: list[str]) -> None:
    """Move the photos with a fault to the skipped ones; DataError if too few are left."""
    checked = list(zip(found.photos, faults, strict=True))
    for one, fault in checked:
        if fault:
            found.skip(one.path, fault.removeprefix(f"{one.path}: "))
    found.photos = [one for one, fault in checked if not fault]
    _check_enough(found)


def _fault(work: Callable[[], None]) -> str:
    """Return the message if ``work``, which reads a photo, fails, else an empty text."""
    try:
        work()
    except DataError as error:
        if "clgs[heif]" in str(error):  # a library is missing, no photo is damaged
            raise
        return str(error)
    return ""


def _write(one: Found, images: Path, masks: Path, equirectangular: bool) -> None:
    mask: Mask | None = None
    check_image(one.path)
    if one.mask:
        check_chunks(one.mask)
    if equirectangular or is_marked(one.path):
        _write_views(one, images, masks)
        return
    if is_plain(one.path):
        if one.mask:
            mask = read_mask(one.mask, image_size(one.path), posed=False)
        copy = images / one.name
        shutil.copyfile(one.path, copy)
    else:
        color, mask = _read(one)
        stem, _, suffix = one.name.rpartition(".")
        copy = images / (one.name if f".{suffix.lower()}" in WRITTEN else f"{stem}.jpg")
        _save(color, one.path, copy)
    if mask is not None and not mask.all():
        save_mask(mask, masks / f"{copy.name}.png")


def _read(one: Found) -> tuple[npt.NDArray[np.uint8], Mask | None]:
    """The pixels (H, W, 3) of a photo, black where they are transparent, and its mask."""
    pixels = read_image(one.path)
    mask = read_mask(one.mask, pixels.size, posed=False) if one.mask else None
    if pixels.alpha is None:
        return pixels.color, mask
    seen = (pixels.alpha >= USED).astype(np.uint8)
    if not seen.any():
        raise DataError(f"{one.path}: is transparent everywhere; remove it")
    return pixels.color * seen[..., None], seen if mask is None else mask * seen


def _write_views(one: Found, images: Path, masks: Path) -> None:
    """Write the views of an equirectangular photo, with their focal length, and their masks."""
    color, mask = _read(one)
    height, width = color.shape[:2]
    if width != 2 * height:
        raise DataError(
            f"{one.path}: is {width}x{height}, and an equirectangular photo is twice as wide as "
            "high; leave --equirectangular out, or this photo"
        )
    exif = Image.Exif()
    exif.get_ifd(_DETAILS)[_FOCAL_35MM] = FOCAL_35MM
    used = None if mask is None else mask * np.uint8(255)
    stem = one.name.rpartition(".")[0]
    for number, view in enumerate(cut(Pixels(color, used))):
        # those of one direction follow each other, in the order of the photos
        copy = images / f"view{number:02}_{stem}.jpg"
        seen = None if view.alpha is None else whole(Pixels(view.alpha[..., None], None))
        if seen is not None and not seen.any():
            continue  # nothing of it is used
        Image.fromarray(view.color).save(
            copy, "JPEG", exif=exif, quality=JPEG_QUALITY, subsampling=0
        )
        if seen is not None and not seen.all():
            save_mask(seen, masks / f"{copy.name}.png")


def _save(color: npt.NDArray[np.uint8], original: Path, copy: Path) -> None:
    """Write upright pixels (H, W, 3), with camera, focal length and place of the original's EXIF.

    GPS tags come along. Other data stays behind: maker's notes may be longer than a JPEG's header.
    """
    with open_image(original) as opened:
        given = read_exif(opened)
        details, gps = given.get_ifd(_DETAILS), given.get_ifd(GPS)
    exif = Image.Exif()
    if gps:
        exif.get_ifd(GPS).update(gps)
    for tag in _CAMERA_TAGS:
        if tag in given:
            exif[tag] = given[tag]
    lens = {tag: details[tag] for tag in _LENS_TAGS if tag in details}
    if lens:
        exif.get_ifd(_DETAILS).update(lens)
    picture = Image.fromarray(color)
    if copy.suffix.lower() == ".png":
        picture.save(copy, "PNG", exif=exif, compress_level=1)
    else:
        picture.save(copy, "JPEG", exif=exif, quality=JPEG_QUALITY, subsampling=0)


def camera_numbers(paths: list[Path], apart: Container[str] = ()) -> list[int]:
    """Number the cameras of photos, from 0: one per size, camera and focal length.

    ``apart``: stems of the names of photos that share no camera with the others.

    Raises:
        DataError: a photo is damaged.
    """
    numbers: dict[tuple[object, ...], int] = {}
    found = []
    for path in paths:
        with open_image(path) as picture:
            exif, size = read_exif(picture), upright_size(picture)
        details = exif.get_ifd(_DETAILS)
        named = [str(exif.get(tag, "")) for tag in _CAMERA_TAGS]
        focal = [str(details.get(tag, "")) for tag in _FOCAL_TAGS]
        found.append(numbers.setdefault((*size, *named, *focal, path.stem in apart), len(numbers)))
    return found
