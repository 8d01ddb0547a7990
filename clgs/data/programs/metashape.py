"""Agisoft Metashape's "Export Cameras" as XML to posed photos.

Poses are camera-to-chunk matrices in OpenCV's axes. The transform of the chunk, or of the camera's
component, leads to the world; if that is the Earth's, about whose centre Metashape computes, the
world here is in metres east, north and up of the chunk's origin. Sources of the lens models: the
appendix "Camera models" of Metashape's manual.
"""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.lens import Lens
from clgs.data.posed_photo import PhotoSet
from clgs.data.programs.listing import (
    checked,
    listed_photo,
    number,
    numbers,
    photo_set,
    pose,
    whole_size,
)
from clgs.errors import DataError
from clgs.scene.world import EARTH, INNERMOST, LOCAL, METRES, NOWHERE, Place, axes_at, place_of

Floats = npt.NDArray[np.float64]

KIND = "metashape"

FISHEYE = "fisheye", "equidistant_fisheye"
TYPES = "frame", *FISHEYE
"""Kinds of sensors whose distortion can be taken out."""

RADIAL = "k1", "k2", "k3", "k4"
UNUSED = "p3", "p4"
"""Coefficients of old versions, which multiply the tangential distortion."""

_TRUE = None, "true", "True", "1"
"""What the attribute ``enabled`` of a camera is, unless it is switched off."""

MAX_BYTES = 256 * 2**20

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _World:
    """The way from a chunk or component to its world: scale * rotation @ x + translation."""

    rotation: Floats
    translation: Floats
    scale: float
    frame: int
    place: Place = NOWHERE


CHUNK = _World(np.eye(3), np.zeros(3), 1.0, LOCAL)
"""The world of a chunk without a transform."""


def find(root: Path) -> Path | None:
    """The XML file of cameras in a folder; cameras.xml comes first."""
    files = sorted(
        root.glob("*.[xX][mM][lL]"), key=lambda p: (p.name.lower() != "cameras.xml", p.name)
    )
    for path in filter(Path.is_file, files):
        with path.open("rb") as file:
            start = file.read(4096)
        if b"<document" in start and b"<chunk" in start:
            return path
    return None


def read(root: Path, file: Path) -> PhotoSet:
    """The enabled and aligned cameras of an XML file.

    Raises:
        DataError: names file, field and remedy.
    """
    chunk = _chunk(file)
    sensors = {one.get("id"): one for one in chunk.iterfind("sensors/sensor")}
    cameras = [one for one in chunk.iterfind("cameras//camera") if one.get("enabled") in _TRUE]
    posed = [one for one in cameras if one.find("transform") is not None]
    if lost := len(cameras) - len(posed):
        _log.warning("%s: %d cameras are not aligned and are left out", file, lost)
    worlds, posed = _worlds(file, chunk, posed)
    listed = []
    for camera in posed:
        name = camera.get("label") or ""
        source = f"{file}: camera {name[:80]!r}"
        matrix = numbers((camera.findtext("transform") or "").split(), (4, 4), source, "transform")
        world = worlds[camera.get("component_id")]
        centre = world.scale * world.rotation @ matrix[:3, 3] + world.translation
        rotation, translation = pose(world.rotation @ matrix[:3, :3], centre, source)
        sensor = sensors.get(camera.get("sensor_id"))
        if sensor is None:
            raise DataError(f"{source}: sensor_id names no sensor; export the cameras again")
        lens = _lens(sensor, f"{file}: sensor {sensor.get('label') or sensor.get('id')!r}")
        listed.append(listed_photo(name, source, rotation, translation, lens))
    found = photo_set(KIND, root, file, listed)
    used = worlds[posed[0].get("component_id")]
    found.frame, found.place = used.frame, used.place
    return found


def _chunk(file: Path) -> ET.Element:
    if file.stat().st_size > MAX_BYTES:
        raise DataError(f"{file}: larger than {MAX_BYTES >> 20} MiB; export fewer cameras")
    data = file.read_bytes()
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise DataError(f"{file}: declares entities, which Metashape never does; export it again")
    try:
        document = ET.fromstring(data)
    except ET.ParseError as error:
        raise DataError(f"{file}: invalid XML ({error}); export it again") from None
    chunks = list(document.iterfind("chunk"))
    if len(chunks) != 1:
        raise DataError(f"{file}: holds {len(chunks)} chunks; export the cameras of one")
    return chunks[0]


def _worlds(
    file: Path, chunk: ET.Element, cameras: list[ET.Element]
) -> tuple[dict[str | None, _World], list[ET.Element]]:
    """The world by id of the component, and the cameras that share one.

    Components have no common world unless all have a transform of the same kind; else only the one
    with most cameras is used.
    """
    whole = _world(file, chunk)
    worlds: dict[str | None, _World] = {None: whole}
    for component in chunk.iterfind("components/component"):
        inner = component.find("transform") is not None
        worlds[component.get("id")] = _world(file, component) if inner else whole
    counts = Counter(camera.get("component_id") for camera in cameras)
    for name in counts:
        worlds.setdefault(name, whole)
    own = [worlds[name] for name in counts]
    if any(world.frame != EARTH for world in own) and len(counts) > 1:
        largest, most = counts.most_common(1)[0]
        kept = [camera for camera in cameras if camera.get("component_id") == largest]
        _log.warning(
            "%s: of %d components with %d cameras the largest with %d is read; align them together",
            *(file, len(counts), len(cameras), most),
        )
        return {name: _local(worlds[name]) for name in worlds}, kept
    first = next(iter(own), whole)
    return {name: _local(world, first) for name, world in worlds.items()}, cameras


def _local(world: _World, first: _World | None = None) -> _World:
    """A world about the Earth's centre in metres east, north and up of the origin of ``first``."""
    if world.frame != EARTH:
        return world
    origin = world.translation if first is None else first.translation
    place = place_of(origin)
    axes = axes_at(place)
    translation = axes @ (world.translation - origin)
    return _World(axes @ world.rotation, translation, world.scale, EARTH, place)


def _world(file: Path, owner: ET.Element) -> _World:
    """The transform of a chunk or component; one about the Earth's centre is left as it is."""
    given = owner.find("transform")
    if given is None:
        return CHUNK
    source = f"{file}: {owner.tag} {owner.get('label') or ''!r}: transform"

    def values(name: str, shape: tuple[int, ...], default: str) -> Floats:
        return numbers((given.findtext(name) or default).split(), shape, source, name)

    rotation = values("rotation", (3, 3), "1 0 0 0 1 0 0 0 1")
    translation = values("translation", (3,), "0 0 0")
    scale = float(values("scale", (), "1"))
    if not scale > 0:
        raise DataError(f"{source}: scale is {scale:g}; correct it")
    measured = given.find("scale")
    locked = measured is not None and measured.get("locked") == "true"
    frame = METRES if locked else LOCAL
    if float(np.linalg.norm(translation)) > INNERMOST:
        frame = EARTH
    return _World(rotation, translation, scale, frame)


def _lens(sensor: ET.Element, source: str) -> Lens:
    """The lens of a sensor: its adjusted calibration, or else the first one."""
    kind = sensor.get("type") or "frame"
    if kind not in TYPES:
        remedy = "export undistorted photos and their cameras"
        if kind == "spherical":
            remedy = "let `clgs prepare --equirectangular` cut the photos and find their poses"
        raise DataError(f"{source}: type {kind!r} is not read; {remedy}")
    calibrations = sensor.findall("calibration")
    calibrations.sort(key=lambda one: one.get("class") != "adjusted")
    if not calibrations or calibrations[0].find("f") is None:
        raise DataError(f"{source}: calibration has no f; align the photos and export again")
    resolution = calibrations[0].find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    width, height = whole_size(
        {} if resolution is None else resolution.attrib, f"{source}: resolution"
    )
    given: dict[str, Any] = {one.tag: one.text for one in calibrations[0]}

    def value(name: str) -> float:
        return number(given, name, source, 0.0)

    if any(value(name) for name in UNUSED):
        raise DataError(f"{source}: p3 and p4 are not read; align with p1 and p2 alone")
    f = number(given, "f", source)
    fx = f + value("b1")
    lens = Lens(
        *(width, height, fx, f, width / 2 + value("cx"), height / 2 + value("cy")),
        radial=tuple(value(name) for name in RADIAL),
        tangential=(value("p2"), value("p1")),
        fisheye=kind in FISHEYE,
        skew=value("b2") / fx if fx else 0.0,
    )
    return checked(lens, source)
