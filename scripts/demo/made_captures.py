"""Photograph scenes: ``python made_captures.py room|tower|street FOLDER [PHOTOS [WIDTH]]``.

FOLDER/images is for structure from motion. FOLDER/transforms.json holds the true poses.

room: panels of one wallpaper cover all four walls, and four equal crates stand in the corners. A
photo of little else fits in several places. Pictures, boxes and balls tell the sides apart.
tower: four equal sides, photographed from all around. Only the ground tells them apart.
street: two rows of houses that all differ, for sets of many photos: four walks from end to end.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from raytrace import Light, RayScene, Surface, View
from scene import ball, box, drum, framed, grid, panel, plane

from clgs.files import atomic_path

HALF, HEIGHT = 3.0, 2.8
"""Size of the room, metres: walls are HALF away from its middle."""

PANELS = 4
"""Equal pieces of wallpaper a wall."""

WIDTH, LOW = 640, 480
"""Size of a photo, pixels."""

LEAST_WIDTH = 16

FOCAL = 0.8
"""Focal length in widths of a photo: a field of view of 64 degrees."""

STOPS = {"room": 40, "tower": 36, "street": 600}
"""Photos of each scene."""

QUALITY = 95

LIGHT = Light(
    towards_sun=np.array([0.3, -0.2, 0.93]),
    sun=np.float32([0.0, 0.0, 0.0]),
    sky=np.float32([1.1, 1.1, 1.1]),
    ground=np.float32([0.8, 0.8, 0.8]),
    sun_radius=0.02,
)
"""A cloudy day through an open roof: no shadows that would tell the sides apart."""


def room_walls() -> list[Surface]:
    """Floor, and the same wallpaper again and again."""
    floor = panel(
        "gravel", (-HALF, HALF, 0), (2 * HALF, 0, 0), (0, -2 * HALF, 0), contrast=0.6, gain=1.5
    )
    found, width = [floor], 2 * HALF / PANELS
    for turn in range(4):
        angle = np.radians(90 * turn)
        right = np.array([np.cos(angle), np.sin(angle), 0.0])
        inward = np.array([np.sin(angle), -np.cos(angle), 0.0])
        for number in range(PANELS):
            corner = -HALF * inward + (number * width - HALF) * right + [0, 0, HEIGHT]
            found.append(panel("brick", corner, width * right, (0, 0, -HEIGHT), gain=1.5))
    return found


def room_clutter() -> list[Surface]:
    """Four equal crates, and things of which there is one each."""
    crates = [
        box(["coffee"], (x, y, 0), (0.7, 0.7, 0.7), 0) for x in (-2.4, 2.4) for y in (-2.4, 2.4)
    ]
    return [
        *(surface for crate in crates for surface in crate),
        *framed("motorcycle", (-1.0, HALF, 1.6), (1.5, 0, 0), 1.0),
        *framed("astronaut", (HALF, 0.6, 1.6), (0, -1.0, 0), 1.0),
        *framed("chelsea", (0.9, -HALF, 1.5), (-1.4, 0, 0), 0.9),
        *framed("rocket", (-HALF, -0.8, 1.6), (0, 1.3, 0), 0.9),
        *box(["chelsea", "astronaut", "rocket"], (0.3, 0.5, 0), (0.7, 0.5, 0.9), 30),
        *box(["immunohistochemistry", "coins"], (-0.6, -0.4, 0), (0.6, 0.6, 0.4), 70),
        ball("retina", (-0.6, -0.4, 0.68), 0.28),
        *drum("motorcycle", "coins", (0.6, -0.7, 0), 0.25, 0.5, 135),
    ]


def tower() -> list[Surface]:
    """A picture on each of four walls of brick, on gravel, and two small things next to it."""
    ground = panel("gravel", (-4, 4, 0), (8, 0, 0), (0, -8, 0), contrast=0.6, gain=1.5)
    found = [ground, *box(["brick"], (0, 0, 0), (1.2, 1.2, 2.0), 0)]
    for turn in range(4):
        angle = np.radians(90 * turn)
        right = np.array([np.cos(angle), np.sin(angle), 0.0])
        outward = np.array([np.sin(angle), -np.cos(angle), 0.0])
        corner = 0.62 * outward - 0.4 * right + [0, 0, 1.6]
        found += framed("astronaut", tuple(corner), tuple(0.8 * right), 0.8)
    small = drum("coins", "coins", (-0.4, 1.6, 0), 0.2, 0.4, 0)
    return [*found, ball("retina", (1.5, 0.4, 0.2), 0.2), *small]


HOUSES, FACADE, WIDE, TALL = 12, 4.0, 8.0, 4.5
"""Houses of a side; metres of a facade, across the street, and up to the roofs."""

TEXELS = 75
"""Per metre of a painted wall."""

WALKS, TURNS = 4, 24
"""Walks from end to end, and photos of the turn at the end of each."""


def leaves(rng: np.random.Generator, across: float, down: float) -> np.ndarray:
    """Linear albedo of a wall, metres: discs of all sizes and colors, the later ones on top."""
    height, width = round(down * TEXELS), round(across * TEXELS)
    tint = rng.uniform(0.3, 1.0, 3)
    picture = np.tile(np.float32(0.4 * tint), (height, width, 1))
    for radius in 3.0 / np.sqrt(rng.uniform(0.002, 1.0, round(60 * across * down))):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        left, top = max(int(x - radius), 0), max(int(y - radius), 0)
        part = picture[top : int(y + radius) + 1, left : int(x + radius) + 1]
        rows, columns = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        part[(rows - y) ** 2 + (columns - x) ** 2 < radius**2] = tint * rng.uniform(0.05, 0.8, 3)
    return picture


def street() -> list[Surface]:
    """Facades on both sides and at both ends, pillars in front of them, and the ground."""
    rng = np.random.default_rng(2)

    def wall(origin: tuple[float, ...], across: tuple[float, ...], down: tuple[float, ...]) -> None:
        size = float(np.linalg.norm(across)), float(np.linalg.norm(down))
        found.append(Surface(plane(origin, across, down), *grid(1, 1), leaves(rng, *size)))

    found: list[Surface] = []
    side, end = WIDE / 2, HOUSES * FACADE
    for x in np.arange(HOUSES) * FACADE:
        wall((x, side, TALL), (FACADE, 0, 0), (0, 0, -TALL))
        wall((x + FACADE, -side, TALL), (-FACADE, 0, 0), (0, 0, -TALL))
        wall((x, side, 0), (FACADE, 0, 0), (0, -WIDE, 0))
        for y in (-side + 0.5, side - 0.5):
            at, wide = x + rng.uniform(0.5, FACADE - 0.5), rng.uniform(0.15, 0.3)
            high = rng.uniform(0.8, 2.0)
            for turn in range(4):
                right = np.array([np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2), 0.0])
                corner = [at, y, high] - wide * right + wide * np.array([right[1], -right[0], 0.0])
                wall(tuple(corner), tuple(2 * wide * right), (0, 0, -high))
    wall((end, side, TALL), (0, -WIDE, 0), (0, 0, -TALL))
    wall((0, -side, TALL), (0, WIDE, 0), (0, 0, -TALL))
    return found


Places = Iterator[tuple[np.ndarray, np.ndarray]]
"""Where the camera is, and what it looks at, (3,) each."""


def places_in_room(stops: int) -> Places:
    """A walk around the middle of the room, looking across it."""
    rng = np.random.default_rng(0)
    for azimuth in np.linspace(0, 2 * np.pi, stops, endpoint=False):
        place = np.array([2.0 * np.cos(azimuth), 2.0 * np.sin(azimuth), 1.5])
        place += rng.uniform(-0.1, 0.1, 3)
        yield place, np.array([0.0, 0.0, 0.8]) + rng.uniform(-0.2, 0.2, 3)


def places_around_tower(stops: int) -> Places:
    """A walk around the tower at arm's length."""
    rng = np.random.default_rng(1)
    for azimuth in np.linspace(0, 2 * np.pi, stops, endpoint=False):
        place = np.array([2.6 * np.cos(azimuth), 2.6 * np.sin(azimuth), 1.3])
        target = np.array([0.0, 0.0, 0.8]) + rng.uniform(-0.1, 0.1, 3)
        yield place + rng.uniform(-0.1, 0.1, 3), target


def places_along_street(stops: int) -> Places:
    """Walks from end to end and back, looking at the left side, with a turn at each end."""
    rng = np.random.default_rng(3)
    ahead = np.radians(55.0)  # between the way and the view
    for number in range(stops):
        walk, share = divmod(number * WALKS / stops, 1)
        turning = min(TURNS * WALKS / stops, 0.5)
        way, turn = min(share / (1 - turning), 1.0), max(share - (1 - turning), 0.0) / turning
        heading = np.pi * (walk % 2)
        along = FACADE / 2 + way * (HOUSES - 1) * FACADE
        x = along if walk % 2 == 0 else HOUSES * FACADE - along
        y = (-1.2 if walk < 2 else -0.4) * np.cos(heading)
        look = heading + ahead + turn * np.pi
        place = np.array([x, y, 1.6]) + rng.uniform(-0.1, 0.1, 3)
        yield place, place + np.array([np.cos(look), np.sin(look), rng.uniform(-0.1, 0.1)])


SCENES: dict[str, tuple[Callable[[], list[Surface]], Callable[[int], Places]]] = {
    "room": (lambda: [*room_walls(), *room_clutter()], places_in_room),
    "tower": (tower, places_around_tower),
    "street": (street, places_along_street),
}


def photograph(
    name: str, folder: Path, stops: int | None = None, width: int = WIDTH
) -> dict[str, View]:
    """Write images/ and transforms.json of a scene; the true cameras by the photos' names."""
    surfaces, places = SCENES[name]
    height, focal = width * LOW // WIDTH, FOCAL * width
    taken = {
        f"{name}_{number:03d}.jpg": View.looking(place, target, focal, width, height)
        for number, (place, target) in enumerate(places(stops or STOPS[name]))
    }
    scene, frames = RayScene(surfaces(), LIGHT), []
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for photo, view in taken.items():
        with atomic_path(folder / "images" / photo) as temporary:
            Image.fromarray(scene.render(view)).save(temporary, quality=QUALITY, subsampling=0)
        matrix = np.eye(4)  # camera to world with y up and z backward, as transforms.json has it
        matrix[:3, :3] = view.rotation.T * [1.0, -1.0, -1.0]
        matrix[:3, 3] = view.centre
        frames.append({"file_path": f"images/{photo}", "transform_matrix": matrix.tolist()})
    lens = {"fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
    document = {**lens, "w": width, "h": height, "frames": frames}
    with atomic_path(folder / "transforms.json") as temporary:
        temporary.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return taken


def main() -> None:
    """The command."""
    numbers = [int(word) if word.isdecimal() else 0 for word in sys.argv[3:]]
    least = 1, LEAST_WIDTH
    fits = len(sys.argv) in (3, 4, 5) and sys.argv[1] in SCENES
    if not fits or any(number < one for number, one in zip(numbers, least, strict=False)):
        usage = f"usage: python made_captures.py {'|'.join(SCENES)} FOLDER [PHOTOS [WIDTH]]"
        raise SystemExit(f"{usage}; at least {least[0]} photo, {least[1]} pixels wide")
    try:
        photograph(sys.argv[1], Path(sys.argv[2]), *numbers)
    except OSError as error:
        raise SystemExit(f"{sys.argv[2]}: {error.strerror}; name another folder") from None


if __name__ == "__main__":
    main()
