"""OpenDroneMap and OpenSfM: reconstruction.json, or cameras.json with shots.geojson.

Lengths of the lens are in units of the photo's longer side. Rotations are vectors of an axis times
an angle, from world to camera in OpenCV's axes. A reconstruction's world is in metres east, north
and up of its reference; the shots of shots.geojson are in metres on a map. Source: OpenSfM's
documentation, "Geometric models" and "Reconstruction file format".
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from clgs.data.lens import Lens
from clgs.data.posed_photo import ListedPhoto, PhotoSet
from clgs.data.programs.listing import (
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
from clgs.scene.world import EARTH, frame_of

KIND = "opendronemap"

RECONSTRUCTIONS = "reconstruction.json", "opensfm/reconstruction.json"
SHOTS = "odm_report/shots.geojson", "shots.geojson"
CAMERAS = "cameras.json"

COEFFICIENTS = {
    "perspective": "k1 k2",
    "simple_radial": "k1",
    "radial": "k1 k2",
    "brown": "k1 k2 k3 p1 p2",
    "fisheye": "k1 k2",
    "fisheye_opencv": "k1 k2 k3 k4",
}
"""Distortion coefficients of the types of projection whose distortion can be taken out."""

_log = logging.getLogger(__name__)


def find(root: Path) -> Path | None:
    """The file of poses in the folder of a project; a reconstruction comes first."""
    for name in RECONSTRUCTIONS:
        if (file := in_any_case(root / name)).is_file():
            return file
    shots = [file for name in SHOTS if (file := in_any_case(root / name)).is_file()]
    return shots[0] if shots and in_any_case(root / CAMERAS).is_file() else None


def read(root: Path, file: Path) -> PhotoSet:
    """The shots of the largest reconstruction and its points, or those of shots.geojson.

    Raises:
        DataError: names file, shot, field and remedy.
    """
    return _read_shots(root, file) if file.suffix.lower() == ".geojson" else _read_model(root, file)


def _read_model(root: Path, file: Path) -> PhotoSet:
    models = [one for one in read_json(file, list) if isinstance(one, dict)]
    models.sort(key=lambda one: -len(lookup(one, "shots", dict, str(file))))
    if not models:
        raise DataError(f"{file}: holds no reconstruction; let OpenSfM reconstruct the photos")
    if len(models) > 1:
        counts = [len(one["shots"]) for one in models]
        _log.warning("%s: of reconstructions of %s shots the first is read", file, counts)
    model = models[0]
    cameras = lookup(model, "cameras", dict, str(file))
    listed = []
    for name, shot in model["shots"].items():
        listed.append(_listed(name, f"{file}: shot {name[:80]!r}", shot, cameras))
    found = photo_set(KIND, root, file, listed)
    points = [one for one in dict(model.get("points") or {}).values() if isinstance(one, dict)]
    if points:
        place = [one.get("coordinates") for one in points]
        color = [one.get("color") or (128, 128, 128) for one in points]
        found.points = numbers(place, (len(points), 3), f"{file}: points", "coordinates")
        level = numbers(color, (len(points), 3), f"{file}: points", "color")
        found.point_colors = np.clip(level, 0, 255).astype(np.uint8)
    reference = model.get("reference_lla") or {}
    names = "latitude", "longitude", "altitude"
    source = f"{file}: reference_lla"
    latitude, longitude, altitude = (number(reference, name, source, 0.0) for name in names)
    if latitude or longitude:
        found.frame, found.place = EARTH, (latitude, longitude, altitude)
    return found


def _read_shots(root: Path, file: Path) -> PhotoSet:
    cameras = read_json(in_any_case(root / CAMERAS))
    listed = []
    for feature in lookup(read_json(file), "features", list, str(file)):
        shot = lookup(feature, "properties", dict, f"{file}: a feature")
        name = lookup(shot, "filename", str, f"{file}: a feature")
        source = f"{file}: shot {name[:80]!r}"
        listed.append(_listed(name, source, shot, cameras, has_centre=True))
    found = photo_set(KIND, root, file, listed)
    found.frame = frame_of(np.array([photo.centre for photo in found.train + found.test]))
    return found


def _listed(
    name: str, source: str, shot: Any, cameras: dict[str, Any], has_centre: bool = False
) -> ListedPhoto:
    """A shot with its camera: the one that it names, with or without "v2 ", or the only one.

    ``has_centre``: what the shot calls its translation is the place of the camera.
    """
    from scipy.spatial.transform import Rotation  # 0.2 s, 30 MB: only where it is needed

    turn, translation = (
        numbers(lookup(shot, field, list, source), (3,), source, field)
        for field in ("rotation", "translation")
    )
    rotation, camera = Rotation.from_rotvec(turn).as_matrix(), shot.get("camera")
    if has_centre:
        rotation, translation = pose(rotation.T, translation, source)
    known = {key.removeprefix("v2 "): value for key, value in cameras.items()}
    given = known.get(str(camera).removeprefix("v2 "))
    if given is None and camera is None and len(known) == 1:
        given = next(iter(known.values()))
    if not isinstance(given, dict):
        raise DataError(f"{source}: camera {str(camera)[:80]!r} is not among the cameras; add it")
    lens = _lens(given, f"{source}: its camera")
    return listed_photo(name, source, rotation, translation, lens)


def _lens(given: dict[str, Any], source: str) -> Lens:
    kind = given.get("projection_type", "perspective")
    if kind not in COEFFICIENTS:
        remedy = "take one of " + ", ".join(COEFFICIENTS)
        if kind in ("spherical", "equirectangular"):
            remedy = "let `clgs prepare --equirectangular` cut the photos and find their poses"
        raise DataError(f"{source}: projection_type {str(kind)[:40]!r} is not read; {remedy}")
    width, height = whole_size(given, source)
    longer = max(width, height)
    fx = number(given, "focal_x" if "focal_x" in given else "focal", source)
    fy = number(given, "focal_y", source, fx)
    x, y = (longer * number(given, name, source, 0.0) for name in ("c_x", "c_y"))
    names = COEFFICIENTS[kind].split()
    values = {name: number(given, name, source, 0.0) for name in names}
    model = "OPENCV_FISHEYE" if "fisheye" in kind else "OPENCV"
    focal, centre = (fx * longer, fy * longer), (width / 2 + x, height / 2 + y)
    return checked(Lens.of_model(model, (width, height), focal, centre, values), source)
