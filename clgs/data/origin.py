"""The data set that a run was trained on: its folder, a few known cameras, and the run's units."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import Dataset
from clgs.data.view import View
from clgs.errors import DataError
from clgs.files import write_json
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform

ORIGIN = "data.json"
"""The file of a run folder that names its data set."""

KNOWN_BY = 8
"""Cameras that are kept, evenly spread over the training views."""

TOLERANCE = 0.05
"""Cameras of the same data differ by less: rotation by entry, centre as a share of the radius.

Photos that were added or removed since move the scene's units by less than this.
"""

UNLIKE = 0.25
"""Scenes whose centres or units differ by a larger share are not of one capture."""


@dataclass(frozen=True)
class Origin:
    """A data set that a run was trained on.

    folder: as it was named, made absolute, or relative to the run if both have moved; places: both
    of these; radius: of the cameras, scene units; cameras: by the photo's name, (3, 4) float64
    rotation and centre, scene units.
    """

    folder: Path
    places: tuple[Path, Path]
    radius: float
    cameras: dict[str, npt.NDArray[np.float64]]

    def check(self, views: list[View], data: Path) -> bool:
        """Whether any of ``views``, which have the run's units, is known to be of this data set.

        Views of other names say nothing: they may be new photos of the same place.

        Raises:
            DataError: a view of the same name has another camera.
        """
        met = [view for view in views if view.name in self.cameras]
        for view in met:
            known = self.cameras[view.name]
            apart = np.abs(_pose(view) - known)
            if apart[:, :3].max() > TOLERANCE or apart[:, 3].max() > TOLERANCE * self.radius:
                raise DataError(
                    f"{data}: the camera of {view.name} is not the one that the scene was trained "
                    f"with, so these photos show another scene; name {self.folder} instead"
                )
        return bool(met)


def write_origin(run: Path, dataset: Dataset) -> None:
    """Write ORIGIN to the folder ``run``; nothing if the data set was not read from a folder."""
    if dataset.folder is None:
        return
    views = dataset.train
    chosen = {int(i) for i in np.linspace(0, len(views) - 1, min(KNOWN_BY, len(views))).round()}
    folder = dataset.folder.resolve()
    try:
        relative = os.path.relpath(folder, run.resolve())
    except ValueError:  # on another drive
        relative = str(folder)
    record = {
        "folder": str(folder),
        "relative": relative,
        "radius": dataset.radius,
        "cameras": {views[i].name: _pose(views[i]).tolist() for i in sorted(chosen)},
    }
    write_json(run / ORIGIN, record)


def read_origin(run: Path) -> Origin | None:
    """The data set of the run in the folder ``run``; None if it does not say.

    Raises:
        DataError: ORIGIN is damaged.
    """
    path = run / ORIGIN
    if not path.is_file():
        return None
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        named, moved = Path(record["folder"]), run / record["relative"]
        cameras = {
            name: np.array(pose, np.float64).reshape(3, 4)
            for name, pose in record["cameras"].items()
        }
        folder = moved if moved.is_dir() and not named.is_dir() else named
        return Origin(folder, (named, moved), float(record["radius"]), cameras)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise DataError(f"{path}: is damaged; remove it and use --data") from error


def _pose(view: View) -> npt.NDArray[np.float64]:
    return np.column_stack([view.camera.rotation, view.camera.centre])


def repose(dataset: Dataset, transform: SceneTransform) -> Dataset:
    """The dataset with cameras in the units of ``transform``; unchanged if it has them already.

    A scene keeps the transform that it was trained with; the photos that were added or removed
    since then would normalise to slightly different units.
    """
    if dataset.transform == transform:
        return dataset
    train, test = (
        [replace(v, camera=move_camera(v.camera, dataset.transform, transform)) for v in views]
        for views in (dataset.train, dataset.test)
    )
    return replace(dataset, train=train, test=test, transform=transform)


def same_place(run: Path, dataset: Dataset, posed: Dataset, data: Path) -> str:
    """See that a data set shows the scene of a run; what to say if that is not certain, or "".

    Args:
        run: folder of the run.
        dataset: read from ``data``.
        posed: the same in the units of the run's scene.
        data: how it is called in errors.

    Raises:
        DataError: it is that of another scene.
    """
    origin = read_origin(run)
    if origin is not None and origin.check(posed.train + posed.test, data):
        return ""
    near = alike(dataset.transform, posed.transform, dataset.radius)
    none = "has none of the photos that the scene was trained with"
    if origin is not None:
        if not near:
            raise DataError(f"{data}: {none}, and other cameras; name {origin.folder} instead")
        return f"{data} {none}; if it shows another scene, name {origin.folder} instead"
    if near:
        return ""
    unlike = "are placed unlike those that the scene was trained with"
    return f"the cameras of {data} {unlike}; if it shows another scene, name the right one"


def alike(one: SceneTransform, other: SceneTransform, radius: float) -> bool:
    """Whether two transforms may be of the same photos, with a few added or removed.

    Args:
        one: world to scene.
        other: world to another scene.
        radius: of the cameras in the units of ``one``.
    """
    apart = one.scale * np.linalg.norm(np.subtract(one.centre, other.centre))
    ratio = max(one.scale, other.scale) / min(one.scale, other.scale)
    return bool(apart < UNLIKE * radius and ratio < 1 + UNLIKE)


def move_camera(camera: Camera, old: SceneTransform, new: SceneTransform) -> Camera:
    """The camera in the units of ``new``: x_cam scales with the scene, t = scale (R centre + t)."""
    world = camera.translation / old.scale - camera.rotation @ np.array(old.centre)
    translation = new.scale * (camera.rotation @ np.array(new.centre) + world)
    return replace(camera, translation=translation)
