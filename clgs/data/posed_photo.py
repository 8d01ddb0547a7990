"""Photos with poses, in the world units of their data set: what all readers give; as JSON, too."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.lens import Lens
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
    def names(self) -> tuple[str, ...]:
        """Its name, and that in the data set if it is another."""
        return (self.name, self.listed) if self.listed else (self.name,)

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
