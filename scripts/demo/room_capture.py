"""Photograph a cluttered room with a repeated pattern: ``python room_capture.py FOLDER``.

FOLDER/images is for structure from motion; FOLDER/transforms.json holds the true poses. Panels of
one wallpaper cover all four walls, and four equal crates stand in the corners: a photo of little
else fits in several places. Pictures, boxes and balls between them tell the sides apart.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from PIL import Image
from raytrace import Light, RayScene, Surface, View
from scene import ball, box, drum, framed, panel

from clgs.files import atomic_path

HALF, HEIGHT = 3.0, 2.8
"""Size of the room, metres: walls are HALF away from its middle."""

PANELS = 4
"""Equal pieces of wallpaper a wall."""

WIDTH, LOW = 640, 480
"""Size of a photo, pixels."""

FOCAL = 0.8
"""Focal length in widths of a photo: a field of view of 64 degrees."""

STOPS = 40
QUALITY = 95

LIGHT = Light(
    towards_sun=np.array([0.3, -0.2, 0.93]),
    sun=np.float32([0.0, 0.0, 0.0]),
    sky=np.float32([1.1, 1.1, 1.1]),
    ground=np.float32([0.8, 0.8, 0.8]),
    sun_radius=0.02,
)
"""A cloudy day through an open roof: no shadows that would tell the sides apart."""


def walls() -> list[Surface]:
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


def clutter() -> list[Surface]:
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


def build() -> RayScene:
    """The room, lit."""
    return RayScene([*walls(), *clutter()], LIGHT)


def views(stops: int = STOPS, width: int = WIDTH) -> Iterator[View]:
    """A walk around the middle of the room, looking across it."""
    rng = np.random.default_rng(0)
    for azimuth in np.linspace(0, 2 * np.pi, stops, endpoint=False):
        place = np.array([2.0 * np.cos(azimuth), 2.0 * np.sin(azimuth), 1.5])
        target = np.array([0.0, 0.0, 0.8])
        yield look(place + rng.uniform(-0.1, 0.1, 3), target + rng.uniform(-0.2, 0.2, 3), width)


def look(place: np.ndarray, target: np.ndarray, width: int = WIDTH) -> View:
    """The upright view from ``place`` to ``target``."""
    forward = (target - place) / np.linalg.norm(target - place)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return View(rotation, -rotation @ place, FOCAL * width, width, width * LOW // WIDTH)


def photograph(folder: Path, stops: int = STOPS, width: int = WIDTH) -> dict[str, View]:
    """Write images/ and transforms.json; the true cameras by the photos' names."""
    taken = {f"room_{number:03d}.jpg": view for number, view in enumerate(views(stops, width))}
    write_capture(folder, build(), taken)
    return taken


def write_capture(folder: Path, scene: RayScene, taken: Mapping[str, View]) -> None:
    """Write images/ and transforms.json of views by the photos' names; all have one lens."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for name, view in taken.items():
        with atomic_path(folder / "images" / name) as temporary:
            Image.fromarray(scene.render(view)).save(temporary, quality=QUALITY, subsampling=0)
    first = next(iter(taken.values()))
    document = {
        "fl_x": first.focal,
        "fl_y": first.focal,
        "cx": first.width / 2,
        "cy": first.height / 2,
        "w": first.width,
        "h": first.height,
        "frames": [_frame(name, view) for name, view in taken.items()],
    }
    with atomic_path(folder / "transforms.json") as temporary:
        temporary.write_text(json.dumps(document, indent=1), encoding="utf-8")


def _frame(name: str, view: View) -> dict[str, object]:
    """Camera to world with y up and z backward, as transforms.json has it."""
    matrix = np.eye(4)
    matrix[:3, :3] = view.rotation.T * [1.0, -1.0, -1.0]
    matrix[:3, 3] = view.centre
    return {"file_path": f"images/{name}", "transform_matrix": matrix.tolist()}


def main() -> None:
    """The command."""
    if len(sys.argv) != 2:
        raise SystemExit("usage: python room_capture.py FOLDER")
    photograph(Path(sys.argv[1]))


if __name__ == "__main__":
    main()
