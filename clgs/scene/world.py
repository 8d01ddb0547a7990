"""What the world of a data set is: its own, one in metres, or a place on the Earth; as text."""

from __future__ import annotations

import math

from clgs.quantities import plain_float

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
