"""Photograph scenes whose parts look alike: ``python alike_captures.py SCENE FOLDER``.

SCENE: tower, four equal sides, from all around; corridor, equal doors, there and back; facade,
equal windows, walking past. FOLDER/images is for structure from motion; FOLDER/transforms.json
holds the true poses. The ground never repeats, and is all that tells the sides of the tower apart.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from raytrace import RayScene, Surface, View
from room_capture import LIGHT, look, write_capture
from scene import ball, box, drum, framed, panel

STEPS, BACK = 36, 24
"""Photos of the tower and the façade; of the corridor, each way."""

SPAN = 6.0
"""Metres from the middle of the corridor to its ends."""

STOREYS = (1.8, 3.6)


def tower() -> list[Surface]:
    """A picture on each of four walls of brick, on gravel, and two small things next to it."""
    found = [_ground(-4.0, 4.0, 4.0), *box(["brick"], (0, 0, 0), (1.2, 1.2, 2.0), 0)]
    for turn in range(4):
        angle = np.radians(90 * turn)
        right = np.array([np.cos(angle), np.sin(angle), 0.0])
        outward = np.array([np.sin(angle), -np.cos(angle), 0.0])
        corner = 0.62 * outward - 0.4 * right + [0, 0, 1.6]
        found += framed("astronaut", tuple(corner), tuple(0.8 * right), 0.8)
    small = drum("coins", "coins", (-0.4, 1.6, 0), 0.2, 0.4, 0)
    return [*found, ball("retina", (1.5, 0.4, 0.2), 0.2), *small]


def corridor() -> list[Surface]:
    """Six times the same picture on either side, and one at each end."""
    found = [_ground(-1.0, 1.0, SPAN)]
    for middle in np.arange(1 - SPAN, SPAN, 2):
        found += [
            panel("brick", (-1, middle - 1, 2.5), (0, 2, 0), (0, 0, -2.5), gain=1.5),
            panel("brick", (1, middle + 1, 2.5), (0, -2, 0), (0, 0, -2.5), gain=1.5),
            *framed("chelsea", (-0.98, middle - 0.4, 1.7), (0, 0.8, 0), 0.7),
            *framed("rocket", (0.98, middle + 0.4, 1.7), (0, -0.8, 0), 0.7),
        ]
    ends = [
        panel("astronaut", (1, -SPAN, 2.5), (-2, 0, 0), (0, 0, -2.5)),
        panel("motorcycle", (-1, SPAN, 2.5), (2, 0, 0), (0, 0, -2.5)),
    ]
    return [*found, *ends]


def facade() -> list[Surface]:
    """Eight times the same wall with a window in each of two storeys."""
    found = [_ground(-8.0, 8.0, 3.0)]
    for left in np.arange(-8.0, 8.0, 2.0):
        found.append(panel("brick", (left, 3, 4), (2, 0, 0), (0, 0, -4), gain=1.5))
        for top in STOREYS:
            found += framed("astronaut", (left + 0.5, 2.98, top), (1, 0, 0), 1.2)
    return [
        *found,
        ball("retina", (-5, 2, 0.3), 0.3),
        *box(["coffee"], (3, 1.6, 0), (0.6,) * 3, 20),
    ]


def _ground(left: float, right: float, far: float) -> Surface:
    across, down = (right - left, 0, 0), (0, -2 * far, 0)
    return panel("gravel", (left, far, 0), across, down, contrast=0.6, gain=1.5)


def around() -> Iterator[View]:
    """Views at arm's length around the tower."""
    rng = np.random.default_rng(1)
    for azimuth in np.linspace(0, 2 * np.pi, STEPS, endpoint=False):
        place = np.array([2.6 * np.cos(azimuth), 2.6 * np.sin(azimuth), 1.3])
        target = np.array([0.0, 0.0, 0.8]) + rng.uniform(-0.1, 0.1, 3)
        yield look(place + rng.uniform(-0.1, 0.1, 3), target)


def there_and_back() -> Iterator[View]:
    """Through the corridor, looking ahead."""
    rng = np.random.default_rng(2)
    for ahead in (1.0, -1.0):
        for way in np.linspace(-5, 4, BACK):
            place = np.array([rng.uniform(-0.3, 0.3), ahead * way, 1.5])
            yield look(place, np.array([rng.uniform(-0.5, 0.5), ahead * (way + 3), 1.3]))


def past() -> Iterator[View]:
    """Along the façade, looking at it."""
    rng = np.random.default_rng(3)
    for x in np.linspace(-6, 6, STEPS):
        place = np.array([x, -2.0, 1.6]) + rng.uniform(-0.1, 0.1, 3)
        yield look(place, np.array([x + rng.uniform(-0.6, 0.6), 3.0, 1.8]))


SCENES: dict[str, tuple[Callable[[], list[Surface]], Callable[[], Iterator[View]]]] = {
    "tower": (tower, around),
    "corridor": (corridor, there_and_back),
    "facade": (facade, past),
}


def photograph(name: str, folder: Path) -> dict[str, View]:
    """Write images/ and transforms.json of a scene; the true cameras by the photos' names."""
    surfaces, views = SCENES[name]
    taken = {f"{name}_{number:03d}.jpg": view for number, view in enumerate(views())}
    write_capture(folder, RayScene(surfaces(), LIGHT), taken)
    return taken


def main() -> None:
    """The command."""
    if len(sys.argv) != 3 or sys.argv[1] not in SCENES:
        raise SystemExit(f"usage: python alike_captures.py {'|'.join(SCENES)} FOLDER")
    try:
        photograph(sys.argv[1], Path(sys.argv[2]))
    except OSError as error:
        raise SystemExit(f"{sys.argv[2]}: {error.strerror}; name another folder") from None


if __name__ == "__main__":
    main()
