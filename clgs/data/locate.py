"""Finds the photos that a data set lists on the disk: safe paths, sizes, masks, lenses."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import numpy.typing as npt

from clgs.data.images import SUFFIXES, posed_size, scales_evenly
from clgs.data.lens import Lens
from clgs.data.masks import find_mask
from clgs.data.posed_photo import Photo
from clgs.errors import DataError

LONGEST_NAME, LONGEST_PATH = 255, 4096
"""Bytes that Linux allows; other systems allow as much or less."""


@dataclass(frozen=True)
class ListedPhoto:
    """A photo as a data set lists it; nothing of it has been looked for on the disk.

    name: path below the folder of the photos, perhaps without its suffix; source: file and place
    that list it, for messages; rotation and translation: as of Photo; size: (width, height) that
    the lens is for, None if the list does not say; lens: gives the lens for a width and a height;
    mask: path of the mask below the data set, None if the list names none; mask_by_name: a mask
    is looked for in the folder masks.
    """

    name: str
    source: str
    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    size: tuple[int, int] | None
    lens: Callable[[int, int], Lens]
    mask: str | None = None
    mask_by_name: bool = False


def locate_all(
    listed: list[ListedPhoto], root: Path, folder: Path, source: str
) -> tuple[list[Photo], list[str]]:
    """The photos that exist, in order, and the names of the missing ones.

    Args:
        listed: of one data set.
        root: folder of the data set, in which masks are looked for.
        folder: folder that the names are relative to.
        source: the file or folder that lists the photos, for messages.

    Raises:
        DataError: as of ``locate``; a photo is listed twice; or no photo exists.
    """
    photos: dict[str, Photo] = {}
    missing: list[str] = []
    for one in listed:
        photo = locate(one, root, folder)
        if photo is None:
            missing.append(one.name)
        elif photo.name in photos:
            raise DataError(f"{one.source}: {photo.name!r} is listed twice; keep one of the two")
        else:
            photos[photo.name] = photo
    if not photos:
        first = f" ({missing[0][:80]} and so on)" if missing else ""
        raise DataError(
            f"{source}: none of the {len(listed)} listed photos is in {folder}; put them there"
            f"{first}"
        )
    return list(photos.values()), missing


def locate(listed: ListedPhoto, root: Path, folder: Path) -> Photo | None:
    """The photo with its lens on the actual pixels and its mask; None if its file is missing.

    Raises:
        DataError: a path leads out of the data set, the photo cannot be read, or its aspect ratio
            is not that of the lens; or the listed mask is missing.
    """
    path = _find_file(listed, folder)
    if path is None:
        return None
    size = posed_size(path, listed.size)
    lens = fit_lens(listed.lens(*(listed.size or size)), size, path)
    mask = find_mask(root, listed.name) if listed.mask_by_name else None
    if listed.mask is not None:
        mask = inside(root, listed.mask, f"{listed.source}: mask_path")
        if not mask.is_file():
            problem = f"names no file ({mask.name[:80]!r}); add it or remove the field"
            raise DataError(f"{listed.source}: mask_path {problem}")
    name = path.relative_to(folder).as_posix()
    return Photo(name, path, lens, listed.rotation, listed.translation, mask)


def _find_file(listed: ListedPhoto, folder: Path) -> Path | None:
    """The existing file of the photo, whose listed name may lack its suffix."""
    path = inside(folder, listed.name, listed.source)
    if path.is_file():
        return path
    suffixes = (*SUFFIXES, *(suffix.upper() for suffix in SUFFIXES))
    extended = (path.with_name(path.name + suffix) for suffix in suffixes)
    found = next((each for each in extended if nameable(each) and each.is_file()), None)
    return found and inside(folder, found.relative_to(folder).as_posix(), listed.source)


def fit_lens(lens: Lens, size: tuple[int, int], path: Path) -> Lens:
    """The lens on an image's actual (width, height).

    Raises:
        DataError: the image has another aspect ratio than the intrinsics.
    """
    width, height = size
    if (width, height) == (lens.width, lens.height):
        return lens
    if not scales_evenly(size, (lens.width, lens.height)):
        raise DataError(
            f"{path}: image is {width}x{height} but its intrinsics are for "
            f"{lens.width}x{lens.height}; crop neither, or correct w, h and the intrinsics"
        )
    return lens.resized(width, height)


def nameable(path: Path) -> bool:
    """Whether common file systems can have such a file."""
    try:
        lengths = [len(os.fsencode(part)) for part in path.parts]
    except UnicodeEncodeError:
        return False
    return max(lengths) <= LONGEST_NAME and sum(lengths) + len(lengths) < LONGEST_PATH


def inside(root: Path, name: str, source: str) -> Path:
    """The path of ``name`` below ``root``.

    Raises:
        DataError: empty, absolute, with '..' or NUL, no name that a file can have, or a link that
            leads out of ``root``.
    """
    portable = name.replace("\\", "/")
    relative = PurePosixPath(portable)
    absolute = relative.is_absolute() or bool(PureWindowsPath(name).drive)
    if not relative.parts or absolute or ".." in relative.parts or "\0" in name:
        raise DataError(f"{source}: path {name[:80]!r} must stay inside the data folder")
    path = root / relative
    if not nameable(path):
        raise DataError(
            f"{source}: path {name[:80]!r} cannot be a file's name; shorten or correct it"
        )
    if not path.resolve().is_relative_to(root.resolve()):
        raise DataError(f"{source}: path {name[:80]!r} is a link out of the data folder; copy it")
    return path
