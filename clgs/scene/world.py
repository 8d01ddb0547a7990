"""What the world of a data set is: its own, one in metres, or a place on the Earth; as text.

Coordinates about the Earth's centre become metres east, north and up of a place. The ellipsoid is
that of WGS 84. Source: Vermeille, "Direct transformation from geocentric to geodetic coordinates"
(2002), for the formulas that need no iteration.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from clgs.arguments import plain_float

FRAMES = "local", "metres", "earth", "map"
"""One of its own units; one in metres; metres east, north and up of a place on the Earth; metres
east, north and up on a map whose coordinate system is not named."""

LOCAL, METRES, EARTH, MAP = range(len(FRAMES))

Place = tuple[float, float, float]
"""Latitude and longitude in degrees, and altitude in metres, on the ellipsoid of WGS 84."""

NOWHERE = (0.0, 0.0, 0.0)

MARK = "world:"
"""The word that a text of a world begins with, as files of splats hold it."""


def is_world(frame: float, place: Place) -> bool:
    """Whether these are a frame, and the place that a frame of this kind has."""
    if frame != EARTH:
        return frame in range(len(FRAMES)) and place == NOWHERE
    latitude, longitude, altitude = place
    return abs(latitude) <= 90 and abs(longitude) <= 360 and abs(altitude) <= 1e7


def to_text(frame: float, place: Place) -> str:
    """A line such as "world: earth 46.9481 7.4474 553.25"; nothing for LOCAL."""
    if frame == LOCAL:
        return ""
    numbers = map(repr, place) if frame == EARTH else ()
    return " ".join([MARK, FRAMES[int(frame)], *numbers])


def from_text(lines: list[str]) -> tuple[int, Place]:
    """The frame and the place of the first line that is one; LOCAL if none is."""
    for line in lines:
        match line.split():
            case [word, name, *numbers] if word == MARK and name in FRAMES:
                frame = FRAMES.index(name)
                try:
                    place = tuple(map(plain_float, numbers)) if frame == EARTH else NOWHERE
                except ValueError:
                    continue
                if len(place) == 3 and all(map(math.isfinite, place)) and is_world(frame, place):
                    return frame, place
    return LOCAL, NOWHERE


def in_words(frame: float, place: Place) -> str:
    """Whether coordinates are local or the world's, and what they mean."""
    if frame == EARTH:
        names = "latitude", "longitude", "altitude"
        where = ", ".join(f"{name} {value!r}" for name, value in zip(names, place, strict=True))
        return f"world: metres east, north and up of {where}"
    return {
        LOCAL: "local, units of its own",
        METRES: "local, metres",
        MAP: "world: metres on a map whose coordinate system is not named",
    }[int(frame)]


Floats = npt.NDArray[np.float64]

SEMI_MAJOR, FLATTENING = 6_378_137.0, 1 / 298.257223563
"""The ellipsoid of WGS 84; the first in metres."""

INNERMOST = 6e6
"""Metres from the centre of the Earth: all that is photographed is farther out."""

LARGE = 1e4
"""Coordinates beyond this are those of a map: no capture is so far from an origin of its own."""


def place_of(geocentric: Floats) -> Place:
    """Latitude and longitude in degrees and altitude of a point (3,) about the Earth's centre."""
    x, y, z = geocentric
    e2 = FLATTENING * (2 - FLATTENING)
    p = (x * x + y * y) / SEMI_MAJOR**2
    q = (1 - e2) * z * z / SEMI_MAJOR**2
    r = (p + q - e2**2) / 6
    s = e2**2 * p * q / (4 * r**3)
    t = np.cbrt(1 + s + np.sqrt(s * (2 + s)))
    u = r * (1 + t + 1 / t)
    v = np.sqrt(u**2 + e2**2 * q)
    w = e2 * (u + v - q) / (2 * v)
    k = np.sqrt(u + v + w**2) - w
    d = k * np.hypot(x, y) / (k + e2)
    altitude = (k + e2 - 1) / k * np.hypot(d, z)
    latitude = 2 * np.arctan2(z, d + np.hypot(d, z))
    return float(np.degrees(latitude)), float(np.degrees(np.arctan2(y, x))), float(altitude)


def geocentric(place: Place) -> Floats:
    """The point (3,) about the Earth's centre, metres, of a latitude, longitude and altitude."""
    (sin_lat, sin_lon), (cos_lat, cos_lon) = (f(np.radians(place[:2])) for f in (np.sin, np.cos))
    e2 = FLATTENING * (2 - FLATTENING)
    normal = SEMI_MAJOR / np.sqrt(1 - e2 * sin_lat**2)
    across = (normal + place[2]) * cos_lat
    return np.array([across * cos_lon, across * sin_lon, (normal * (1 - e2) + place[2]) * sin_lat])


def axes_at(place: Place) -> Floats:
    """East, north and up at a place, the rows of (3, 3), in axes about the Earth's centre."""
    (sin_lat, sin_lon), (cos_lat, cos_lon) = (f(np.radians(place[:2])) for f in (np.sin, np.cos))
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )


def frame_of(centres: Floats) -> int:
    """MAP if cameras (N, 3) in metres are so far from the origin that it is a map's, or METRES."""
    return MAP if np.abs(np.median(centres, axis=0)).max() > LARGE else METRES
