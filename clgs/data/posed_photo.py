"""Photos with poses, in the world units of their data set: what all readers give; as JSON, too.

The photos that a data set lists are found on the disk: safe paths, sizes, masks, lenses.
"""

from __future__ import annotations

import logging
import os
import re
import unicodedata
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from clgs.data.images import SUFFIXES, posed_size, scales_evenly
from clgs.data.lens import Lens
from clgs.data.masks import find_mask
from clgs.data.reduction import EVERY
from clgs.errors import DataError
from clgs.scene.world import EARTH, LOCAL, MAP, NOWHERE, Place

Y_UP = "polycam", "record3d"
"""Kinds of data sets whose world is that of ARKit."""

_FROM_Z_UP = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
_FROM_Y_DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))


@dataclass(frozen=True)
class Photo:
    """One photo with its pose: x_cam = rotation @ x_world + translation, OpenCV axes.

    name: unique, relative to the data set, forward slashes; lens: for the pixels in the file;
    rotation (3, 3), translation (3,) float64 in the data's world units; mask: the file that says
    which pixels are used, if there is one; listed: the name that the data set has for it, if it is
    not that of the file.
    """

    name: str
    path: Path
    lens: Lens
    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    mask: Path | None = None
    listed: str = ""

    @property
    def centre(self) -> npt.NDArray[np.float64]:
        """Camera centre (3,) float64 in world units."""
        return np.asarray(-self.rotation.T @ self.translation)


@dataclass
class PhotoSet:
    """A data set whose images are not decoded yet.

    kind: "blender", "transforms", "colmap", or the program that made it; missing: names of photos
    that are not on disk; points (P, 3) float64 world units and point_colors (P, 3) uint8, or None
    if the set has none; points_file: the file that the data set names for its points, not read yet;
    models: if there are several COLMAP models, their names and numbers of photos; the first was
    read; stray_masks: names of what seem to be masks of no photo; split: the data set itself says
    what is held out; frame and place: what the world is, as of SceneTransform.
    """

    kind: str
    train: list[Photo]
    test: list[Photo]
    missing: list[str] = field(default_factory=list)
    points: npt.NDArray[np.float64] | None = None
    point_colors: npt.NDArray[np.uint8] | None = None
    points_file: Path | None = None
    models: dict[str, int] = field(default_factory=dict)
    stray_masks: list[str] = field(default_factory=list)
    split: bool = False
    frame: int = LOCAL
    place: Place = NOWHERE

    def models_in_words(self) -> str:
        """A sentence on the COLMAP models if there are several, else nothing."""
        first, *others = self.models or [""]
        left = ", ".join(f"{name} with {self.models[name]}" for name in others[:8])
        read = f"{first} with {self.models.get(first)} photos is read"
        return f"there are {len(self.models)} COLMAP models; {read}, not {left}" if left else ""


def hold_out(photos: list[Photo], every: int = EVERY) -> tuple[list[Photo], list[Photo]]:
    """(train, test): sorted by name, photos 0, ``every``, ... are the test photos; 0: none are."""
    ordered = sorted(photos, key=lambda photo: photo.name)
    if not every:
        return ordered, []
    return [photo for i, photo in enumerate(ordered) if i % every], ordered[::every]


def rigid(matrix: npt.NDArray[np.float64], source: str) -> npt.NDArray[np.float64]:
    """The rotation (3, 3) nearest to a nearly orthonormal ``matrix``.

    Raises:
        DataError: not finite, scaled, sheared or mirrored.
    """
    if not np.all(np.isfinite(matrix)):
        raise DataError(f"{source} is not finite; recompute the poses")
    product = matrix @ matrix.T
    if not (np.abs(product - np.eye(3)).max() <= 1e-2 and np.linalg.det(matrix) > 0):
        raise DataError(f"{source} is not a rotation; recompute the poses")
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def to_y_up(kind: str, frame: float) -> npt.NDArray[np.float64]:
    """The rotation (3, 3) from the world of a data set to glTF's axes; its transpose goes back.

    glTF's y points up, and so does that of the apps of phones. COLMAP models have no up of their
    own; it is taken to be -y, as if the first camera was held upright. All others, and all worlds
    on the Earth, have z up.

    Args:
        kind: of the data set, as of PhotoSet.
        frame: of its world, as of SceneTransform.
    """
    if frame in (EARTH, MAP):
        return np.array(_FROM_Z_UP)
    if kind in Y_UP:
        return np.eye(3)
    return np.array(_FROM_Y_DOWN if kind == "colmap" else _FROM_Z_UP)


def to_plain(photo: Photo) -> dict[str, Any]:
    """Convert a photo to texts, numbers and lists."""
    arrays = {"rotation": photo.rotation.tolist(), "translation": photo.translation.tolist()}
    mask = None if photo.mask is None else str(photo.mask)
    files = {"path": str(photo.path), "mask": mask}
    return {"name": photo.name, "lens": asdict(photo.lens), **files, **arrays}


def from_plain(plain: dict[str, Any]) -> Photo:
    """Make a photo of what :func:`to_plain` returned."""
    lens: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in plain["lens"].items()
    }
    rotation, translation = (
        np.array(plain[name], np.float64) for name in ("rotation", "translation")
    )
    mask = None if plain["mask"] is None else Path(plain["mask"])
    return Photo(plain["name"], Path(plain["path"]), Lens(**lens), rotation, translation, mask)


_log = logging.getLogger(__name__)

LONGEST_NAME, LONGEST_PATH = 255, 4096
"""Bytes that Linux allows; other systems allow as much or less."""


@dataclass(frozen=True)
class ListedPhoto:
    """A photo as a data set lists it; nothing of it has been looked for on the disk.

    name: path below the folder of the photos, perhaps without its suffix; source: file and place
    that list it, for messages; rotation and translation: as of Photo; size: (width, height) that
    the lens is for, None if the list does not say; lens: gives the lens for a width and a height;
    mask: path of the mask below the data set; None if the list names none, so that one is looked
    for in the folder masks.
    """

    name: str
    source: str
    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    size: tuple[int, int] | None
    lens: Callable[[int, int], Lens]
    mask: str | None = None


class PhotoFolder:
    """The files of a folder, found by the names that a data set has for them.

    A name that no file has also finds the one file that differs from it in no more than these:
    capitals, slashes, Unicode's forms of one letter or space, escapes of URLs, characters that
    Windows replaces, .jpeg for .jpg, and the folders above, if the name is that of another machine.
    """

    def __init__(self, path: Path) -> None:
        """``path`` is the folder that names are relative to; nothing is read yet."""
        self.path = path
        self._alike: dict[str, list[Path]] | None = None

    def find(self, listed: ListedPhoto) -> Path | None:
        """The file of the photo, whose listed name may lack its suffix; None if there is none.

        Raises:
            DataError: as of ``inside``, unless a file fits.
        """
        # A file inside the folder may have this very name, be it with colons or backslashes.
        name, path = listed.name, self.path / listed.name
        safe = not Path(name).is_absolute() and ".." not in path.parts and "\0" not in name
        there = safe and nameable(path) and path.is_file()
        if there and path.resolve().is_relative_to(self.path.resolve()):
            return path
        try:
            path = inside(self.path, listed.name, listed.source)
        except DataError:
            found = self._find_alike(listed)
            if found is None:
                raise
            return found
        if path.is_file():
            return path
        suffixes = (*SUFFIXES, *(suffix.upper() for suffix in SUFFIXES))
        extended = (path.with_name(path.name + suffix) for suffix in suffixes)
        suffixed = next((each for each in extended if nameable(each) and each.is_file()), None)
        if suffixed is None:
            return self._find_alike(listed)
        return inside(self.path, suffixed.relative_to(self.path).as_posix(), listed.source)

    def _find_alike(self, listed: ListedPhoto) -> Path | None:
        name = plain_name(listed.name)
        if self._alike is None:
            self._alike = {}
            for where, _, files in os.walk(self.path):
                for path in (Path(where, file) for file in files):
                    if path.suffix.lower() in SUFFIXES:
                        key = plain_name(path.relative_to(self.path).as_posix())
                        self._alike.setdefault(key, []).append(path)
        names = [name, *(name + suffix for suffix in SUFFIXES)]
        found = [path for each in names for path in self._alike.get(each, ())]
        if not found and _absolute(listed.name):
            places = name.split("/")
            below = ("/".join(places[start:]) for start in range(1, len(places)))
            found = next((self._alike[each] for each in below if each in self._alike), [])
            if not found:
                ends = "/" + places[-1]
                found = [
                    p
                    for key, paths in self._alike.items()
                    for p in paths
                    if ("/" + key).endswith(ends)
                ]
        if len(found) > 1:
            named = ", ".join(path.name for path in found[:3])
            _log.warning("%s: %d files fit: %s; keep one", listed.source, len(found), named)
        one = found[0] if len(found) == 1 else None
        usable = one is not None and one.resolve().is_relative_to(self.path.resolve())
        return one if usable and ".." not in name.split("/") else None


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
    files = PhotoFolder(folder)
    for one in listed:
        photo = locate(one, root, files)
        if photo is None:
            missing.append(one.name)
        elif photo.name in photos:
            raise DataError(f"{one.source}: {photo.name!r} is listed twice; keep one of the two")
        else:
            photos[photo.name] = photo
    if not listed:
        raise DataError(f"{source}: lists no photos; export the poses again")
    if not photos:
        first = f" ({missing[0][:80]} and so on)" if missing else ""
        others = sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES)
        there = ""
        if others:
            example = others[0].relative_to(folder).as_posix()
            there = f"; {example[:80]!r} is one of {len(others)} that are there"
        raise DataError(
            f"{source}: none of the {len(listed)} listed photos is in {folder}{there}; put them "
            f"there{first}"
        )
    renamed = [photo for photo in photos.values() if photo.listed]
    if renamed:
        example = f"{renamed[0].listed[:80]!r} is {renamed[0].name[:80]!r}"
        _log.warning("%s: %d photos have other names: %s", source, len(renamed), example)
    return list(photos.values()), missing


def locate(listed: ListedPhoto, root: Path, files: PhotoFolder) -> Photo | None:
    """The photo with its lens on the actual pixels and its mask; None if its file is missing.

    Raises:
        DataError: a path leads out of the data set, the photo cannot be read, or its aspect ratio
            is not that of the lens, or the list gives no size and a centre of another one; or
            the listed mask is missing.
    """
    path = files.find(listed)
    if path is None:
        return None
    width, height = size = posed_size(path, listed.size)
    lens = listed.lens(*(listed.size or size))
    if not scales_evenly(size, (lens.width, lens.height)):
        raise DataError(
            f"{path}: image is {width}x{height} but its intrinsics are for "
            f"{lens.width}x{lens.height}; crop neither, or correct w, h and the intrinsics"
        )
    lens = lens.resized(width, height)
    if listed.size is None and lens.is_of_another_size:
        raise DataError(
            f"{listed.source}: the centre of the lens, {lens.cx:g} {lens.cy:g}, is not that of "
            f"{path.name!r}, which is {lens.width}x{lens.height}; give the w and h it is for"
        )
    name = path.relative_to(files.path).as_posix()
    portable = PurePosixPath(listed.name.replace("\\", "/")).as_posix()
    other = "" if name in (portable, f"{portable}{path.suffix}") else listed.name
    if listed.mask is None:
        found = (find_mask(root, files.path, each) for each in (portable, name))
        mask = next(filter(None, found), None)
    else:
        mask = inside(root, listed.mask, f"{listed.source}: mask_path")
        if not mask.is_file():
            problem = f"names no file ({mask.name[:80]!r}); add it or remove the field"
            raise DataError(f"{listed.source}: mask_path {problem}")
    return Photo(name, path, lens, listed.rotation, listed.translation, mask, other)


def plain_name(name: str) -> str:
    """A name of a photo without what may differ between machines."""
    text = unicodedata.normalize("NFKC", unquote(name).replace("\\", "/")).casefold()
    text = PurePosixPath(re.sub(r'[<>:"|?*]', "_", text)).as_posix()
    return re.sub(r"\.jpeg$", ".jpg", text)


def _absolute(name: str) -> bool:
    drive = PureWindowsPath(name).drive
    return bool(drive) or PurePosixPath(name.replace("\\", "/")).is_absolute()


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
    if not relative.parts or _absolute(name) or ".." in relative.parts or "\0" in name:
        raise DataError(f"{source}: path {name[:80]!r} must stay inside the data folder")
    path = root / relative
    if not nameable(path):
        raise DataError(
            f"{source}: path {name[:80]!r} cannot be a file's name; shorten or correct it"
        )
    if not path.resolve().is_relative_to(root.resolve()):
        raise DataError(f"{source}: path {name[:80]!r} is a link out of the data folder; copy it")
    return path
