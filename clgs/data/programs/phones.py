"""Captures of the apps Polycam (raw data) and Record3D (EXR + JPG, or an unpacked .r3d).

Both give ARKit's poses from camera to world, in metres: the world's y is up, the camera's axes are
OpenGL's. Depth maps are not used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clgs.data.images import list_images
from clgs.data.lens import Lens
from clgs.data.posed_photo import PhotoSet
from clgs.data.programs.listing import (
    FROM_OPENGL,
    checked,
    listed_photo,
    lookup,
    number,
    numbers,
    photo_set,
    pose,
    whole_size,
)
from clgs.data.transforms import read_json
from clgs.errors import DataError
from clgs.files import in_any_case
from clgs.scene.world import METRES

POLYCAM, RECORD3D = "polycam", "record3d"

CORRECTED = "corrected_cameras", "corrected_images"
AS_TAKEN = "cameras", "images"
"""Folders below keyframes: the poses that the app corrected, if it has, are the better ones."""

METADATA = "metadata.json", "metadata"
PHOTOS = "rgb", "rgbd", "EXR_RGBD/rgb"
"""Where Record3D's exports have their photos, 0.jpg, 1.jpg and so on."""


def find_polycam(root: Path) -> Path | None:
    """The folder of cameras that has photos next to it."""
    for base in (root / "keyframes", root):
        for cameras, images in (CORRECTED, AS_TAKEN):
            if any((base / cameras).glob("*.[jJ][sS][oO][nN]")) and (base / images).is_dir():
                return base / cameras
    return None


def read_polycam(root: Path, folder: Path) -> PhotoSet:
    """The photos of a folder of cameras, one JSON file each.

    Raises:
        DataError: names file, field and remedy.
    """
    listed = []
    for file in sorted(folder.glob("*.[jJ][sS][oO][nN]")):
        given, source = read_json(file), str(file)
        names = [f"t_{row}{column}" for row in range(3) for column in range(4)]
        matrix = np.array([number(given, name, source) for name in names]).reshape(3, 4)
        rotation, translation = pose(matrix[:, :3] * FROM_OPENGL, matrix[:, 3], source)
        size = whole_size(given, source)
        lens = Lens(*size, *(number(given, name, source) for name in ("fx", "fy", "cx", "cy")))
        listed.append(listed_photo(file.stem, source, rotation, translation, checked(lens, source)))
    images = folder.with_name(folder.name.replace("cameras", "images"))
    found = photo_set(POLYCAM, root, folder, listed, images)
    found.frame = METRES
    return found


def find_record3d(root: Path) -> Path | None:
    """The file of metadata, if it has poses and there are photos."""
    for file in (in_any_case(root / name) for name in METADATA):
        if file.is_file() and _photos(root) is not None:
            with file.open("rb") as opened:
                if b'"poses"' in opened.read():
                    return file
    return None


def _photos(root: Path) -> Path | None:
    places = (root / name for name in PHOTOS)
    return next((place for place in places if place.is_dir() and list_images(place)), None)


def read_record3d(root: Path, file: Path) -> PhotoSet:
    """The frames of a capture, each with its own intrinsics if it has them.

    Raises:
        DataError: names file, frame, field and remedy.
    """
    given, source = read_json(file), str(file)
    size = whole_size(given, source, ("w", "h"))
    poses = lookup(given, "poses", list, source)
    own = given.get("perFrameIntrinsicCoeffs") or []
    if own and (not isinstance(own, list) or len(own) != len(poses)):
        raise DataError(
            f"{file}: perFrameIntrinsicCoeffs has not one entry for each of the {len(poses)} "
            "poses; export again"
        )
    from scipy.spatial.transform import Rotation  # 0.2 s, 30 MB: only where it is needed

    shared = () if own else numbers(given.get("K"), (9,), source, "K")[[0, 4, 6, 7]]
    listed = []
    for frame, values in enumerate(poses):
        at = f"{file}: frame {frame}"
        x, y, z, w, *centre = numbers(values, (7,), at, "pose")
        if not abs(np.linalg.norm([x, y, z, w]) - 1) < 0.01:
            raise DataError(f"{at}: pose begins with no unit quaternion; export again")
        axes = Rotation.from_quat([x, y, z, w]).as_matrix() * FROM_OPENGL
        rotation, translation = pose(axes, np.array(centre), at)
        lens = Lens(*size, *(numbers(own[frame], (4,), at, "intrinsics") if own else shared))
        listed.append(listed_photo(str(frame), at, rotation, translation, checked(lens, at)))
    found = photo_set(RECORD3D, root, file, listed, _photos(root))
    found.frame = METRES
    return found
