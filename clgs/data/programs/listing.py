"""What the readers of other programs' cameras share: checked numbers, poses, the folder of photos.

A source is the file and the place in it that an error names.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import plain_numbers
from clgs.data.images import list_images
from clgs.data.lens import Lens
from clgs.data.posed_photo import ListedPhoto, PhotoSet, hold_out, locate_all, rigid
from clgs.data.transforms import FOCAL_LENGTHS
from clgs.errors import DataError

Floats = npt.NDArray[np.float64]

MAX_COORDINATE = 1e12
"""A larger number is no coordinate, no size and no coefficient."""

FROM_OPENGL = np.array([1.0, -1.0, -1.0])
"""Signs of a camera's axes in OpenGL, y up and z backwards, to those of OpenCV."""


def numbers(value: Any, shape: tuple[int, ...], source: str, field: str) -> Floats:
    """The finite numbers of ``value``, which may be texts, in an array of this shape.

    Raises:
        DataError: other or fewer or too large ones; names source and field.
    """
    try:
        found = np.array(plain_numbers(value), np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        found = np.array(np.nan)
    count = int(np.prod(shape))
    if found.size != count or not np.all(np.abs(found) < MAX_COORDINATE):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise DataError(f"{source}: {field} is not {wanted}; correct it, or export again")
    return found.reshape(shape)


def number(table: Any, field: str, source: str, default: float | None = None) -> float:
    """A finite number of a table; DataError if it is missing and there is no default."""
    if default is not None and field not in table:
        return default
    return float(numbers(table.get(field), (), source, field))


def lookup(table: Any, field: str, kind: type, source: str) -> Any:
    """A field of a JSON object; DataError unless it is there and of that type."""
    found = table.get(field) if isinstance(table, dict) else None
    if not isinstance(found, kind):
        raise DataError(f"{source}: {field} is missing or malformed; export again")
    return found


def pose(axes: Floats, centre: Floats, source: str) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and translation (3,) from world to camera.

    Args:
        axes: (3, 3), the camera's axes x right, y down, z forward as columns, in the world.
        centre: (3,) of the camera.
        source: see the module.

    Raises:
        DataError: the axes are no rotation.
    """
    rotation = rigid(axes, f"{source}: the rotation").T
    return rotation, -rotation @ centre


def whole_size(table: Any, source: str, names: tuple[str, str] = ("width", "height")) -> Any:
    """(width, height) of a table as whole numbers; DataError if there is no such image."""
    width, height = (round(number(table, name, source)) for name in names)
    if not (1 <= width <= 1_000_000 and 1 <= height <= 1_000_000):
        raise DataError(f"{source}: {' and '.join(names)} are no size of an image; correct them")
    return width, height


def checked(lens: Lens, source: str) -> Lens:
    """The lens; DataError if its focal lengths are none."""
    least, most = FOCAL_LENGTHS
    if not (least <= lens.fx <= most and least <= lens.fy <= most):
        raise DataError(
            f"{source}: the focal length is {lens.fx:g}, not {least:g} to {most:g} pixels; "
            "correct it"
        )
    return lens


def listed_photo(
    name: str, source: str, rotation: Floats, translation: Floats, lens: Lens
) -> ListedPhoto:
    """A photo of a known lens; its mask is found by name."""
    size = lens.width, lens.height
    return ListedPhoto(name, source, rotation, translation, size, lens.resized)


def photo_set(
    kind: str, root: Path, file: Path, listed: list[ListedPhoto], folder: Path | None = None
) -> PhotoSet:
    """The photos that exist, every 8th by name held out, and the names of the others.

    Args:
        kind: of the data set.
        root: its folder.
        file: lists the photos.
        listed: all of them.
        folder: of the photos; default: where most files have their names.

    Raises:
        DataError: as of ``locate_all``, or no photo is listed.
    """
    if not listed:
        raise DataError(f"{file}: no camera has a pose; align the photos and export again")
    if folder is None:
        images = root / "images"
        below = sorted(path for path in root.iterdir() if path.is_dir() and path != images)
        stems = {_stem(one.name) for one in listed}
        places = [place for place in (images, root, *below) if place.is_dir()]
        named = [len(stems & {_stem(path.name) for path in list_images(place)}) for place in places]
        folder = places[int(np.argmax(named))]
    photos, missing = locate_all(listed, root, folder, str(file))
    return PhotoSet(kind, *hold_out(photos), missing)


def _stem(name: str) -> str:
    last = PurePosixPath(name.replace("\\", "/")).name.lower()
    known = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff")
    return last.rpartition(".")[0] if last.endswith(known) else last
