"""Where photos were taken, by the GPS tags of their EXIF data: near photos, scale and place.

Tags are off by metres and sometimes lie, so that they are no poses. They choose pairs of large
sets, and a model is laid over them if they are exact enough for its size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.images import open_image, read_exif
from clgs.poses.evidence import Poses
from clgs.poses.workspace import Workspace
from clgs.scene.world import EARTH, NOWHERE, Place, axes_at, geocentric, is_world

Floats = npt.NDArray[np.float64]

GPS = 0x8825
"""The EXIF tag of the table of GPS tags."""

_NORTH, _LATITUDE, _EAST, _LONGITUDE, _BELOW, _ALTITUDE = range(1, 7)

LEAST_TAGS = 4
"""Fewer tags confirm no fit."""

EXACT = 0.1
"""The largest median distance of tags from the fitted model, in median distances of the tags from
their middle."""

LIE, LIE_METRES = 5.0, 20.0
"""A tag lies if it is this many times the median distance off, and this many metres."""

FLAT = 0.02
"""The least ratio of a path's second extent to its first; a straight line tells no roll."""

UPRIGHT = -0.25
"""Least mean share of up in the cameras' own up, and half of that of down in their view: tags that
are mirrored, as without E or W, fit a level path as well, turned upside down."""

NAMED = 5


def read_place(path: Path) -> Place | None:
    """Read latitude, longitude and altitude of a photo's GPS tags; None without usable ones.

    The altitude is NaN if there is none.
    """
    with open_image(path) as picture:
        tags = read_exif(picture).get_ifd(GPS)
    try:
        latitude, longitude = (_degrees(tags[tag]) for tag in (_LATITUDE, _LONGITUDE))
        altitude = float(tags[_ALTITUDE]) if _ALTITUDE in tags else math.nan
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    if str(tags.get(_NORTH, "N")).strip("\0 ").upper() == "S":
        latitude = -latitude
    if str(tags.get(_EAST, "E")).strip("\0 ").upper() == "W":
        longitude = -longitude
    if tags.get(_BELOW) in (1, b"\1"):
        altitude = -altitude
    place = latitude, longitude, altitude
    known = is_world(EARTH, (latitude, longitude, 0.0 if math.isnan(altitude) else altitude))
    return place if known and (latitude or longitude) else None  # 0, 0 is what no fix writes


def _degrees(parts: Any) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    return degrees + minutes / 60 + seconds / 3600


def read_positions(paths: Iterable[Path]) -> tuple[dict[str, Floats], Place, list[str]]:
    """Read where photos were taken, (3,) metres east, north and up of a place in their middle.

    Photos whose tags have no altitude get the median of the others, or 0.

    Returns:
        The positions by the names of the files, of those with GPS tags; the place; and the notes
        for the user.
    """
    places = {path.name: place for path in paths if (place := read_place(path))}
    if not places:
        return {}, NOWHERE, []
    table, notes = np.array(list(places.values())), []
    if (level := np.isnan(table[:, 2])).any():
        usual = 0.0 if level.all() else float(np.median(table[~level, 2]))
        few = f"{level.sum()} of {len(level)} photos"
        notes = [f"GPS tags of {few} have no altitude; {usual:g} m is assumed"]
        table[level, 2] = usual
        places = {name: tuple(row) for name, row in zip(places, table.tolist(), strict=True)}
    middle = np.median(table, axis=0)
    origin = float(middle[0]), float(middle[1]), float(middle[2])
    axes, centre = axes_at(origin), geocentric(origin)
    found = {name: axes @ (geocentric(place) - centre) for name, place in places.items()}
    return found, origin, notes


def fit(workspace: Workspace, poses: Poses) -> tuple[Any | None, list[str]]:
    """Fit a similarity from a model's world to that of the GPS tags.

    Returns:
        pycolmap's Sim3d, None if the tags do not tell one; and the notes for the user.
    """
    placed = set(poses.names)
    names = [name for name in workspace.positions if name in placed]
    if len(names) < LEAST_TAGS:
        return None, []
    tags = np.array([workspace.positions[name] for name in names])
    poses = poses.chosen(names)
    away = tags - np.median(tags, axis=0)
    extent = float(np.median(np.linalg.norm(away, axis=1)))
    spread = np.linalg.svd(poses.centre - poses.centre.mean(0), compute_uv=False)
    unused = "GPS tags give no scale"
    if extent <= 0.0:
        return None, [f"{unused}: all are the same"]
    if spread[1] < FLAT * spread[0]:
        return None, [f"{unused}: the photos were taken along a straight line"]
    pycolmap = workspace.pycolmap
    options = pycolmap.RANSACOptions()
    options.max_error, options.random_seed = 2 * EXACT * extent, workspace.seed
    estimate = pycolmap.estimate_sim3d_robust(poses.centre, tags, options)
    if estimate is None:
        return None, [f"{unused}: they contradict the poses"]
    found = estimate["tgt_from_src"]
    moved = np.array([found * one for one in poses.centre])
    off = np.linalg.norm(moved - tags, axis=1)
    usual = float(np.median(off))
    if usual > EXACT * extent:
        return None, [
            f"{unused}: they are {usual:.1f} m off the poses at the median, on {extent:.1f} m"
        ]
    turned = found.rotation.matrix() @ poses.rotation.transpose(0, 2, 1)
    upright = -turned[:, 2, 1] - turned[:, 2, 2] / 2  # image up, and half of looking down
    if float(upright.mean()) < UPRIGHT:
        return None, [
            f"{unused}: cameras would stand on their heads; the tags are mirrored: check N and S, "
            "E and W, and which is the latitude"
        ]
    lying = [
        f"{name} by {distance:.0f} m"
        for name, distance in zip(names, off.tolist(), strict=True)
        if distance > max(LIE * usual, LIE_METRES)
    ]
    notes = [f"GPS tags give scale and place: {usual:.2f} m off the poses at the median"]
    if lying:
        more = ", ..." * (len(lying) > NAMED)
        notes.append(f"GPS tags contradict the poses of {', '.join(lying[:NAMED])}{more}")
    return found, notes
