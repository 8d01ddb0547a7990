"""Photograph the exhibits alone, from all around: ``python object_capture.py FOLDER``.

A capture in Blender's format, with alpha, known poses and glossy surfaces.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image
from raytrace import SAMPLES, Floats, RayScene, View, develop, unit
from scene import LIGHT, exhibits

SIZE = 400
FIELD_OF_VIEW = 0.69
CAMERA_RADIUS = 4.0
VIEWS = {"train": 60, "test": 4}

SCALE = 0.9
"""Scale of the exhibits, metres to scene units: they fill the pictures."""

TARGET = np.array([-0.1, 0.1, 0.6])
MIRROR, HIGHLIGHT, SHARPNESS = 0.04, 0.5, 60.0


class GlossyScene(RayScene):
    """Surfaces that mirror the sky a little, and the sun."""

    def shade(self, origin: Floats, direction: Floats, towards_sun: Floats) -> Floats:
        """Trace like :class:`RayScene`, with mirrored surfaces; black and -1 without a hit."""
        color = super().shade(origin, direction, towards_sun)
        hits = self.trace(origin, direction)
        facing = -np.einsum("rc,rc->r", hits.normal, direction)
        mirrored = direction + 2 * facing[:, None] * hits.normal
        up = 0.5 + 0.5 * mirrored[:, 2:]
        around = up * self.light.sky + (1 - up) * self.light.ground
        fresnel = MIRROR + (1 - MIRROR) * (1 - np.clip(facing, 0, 1)) ** 5
        sun = np.clip(mirrored @ towards_sun, 0, 1) ** SHARPNESS
        color += fresnel[:, None] * around + HIGHLIGHT * sun[:, None] * self.light.sun
        color[hits.face < 0] = -1.0
        return np.asarray(color, np.float32)

    def photograph(self, view: View) -> npt.NDArray[np.uint8]:
        """RGBA (H, W, 4) of ``view``."""
        rows = view.height * view.width
        total, covered = np.zeros((rows, 3), np.float32), np.zeros((rows, 1), np.float32)
        origin = np.broadcast_to(view.centre.astype(np.float32), total.shape).copy()
        for sample, sun in enumerate(self._sun_spots()):
            row, column = divmod(sample, SAMPLES)
            shift = ((column + 0.5) / SAMPLES, (row + 0.5) / SAMPLES)
            color = self.shade(origin, view.rays(shift), sun)
            hit = color[:, :1] >= 0
            total += np.where(hit, color, 0.0)
            covered += hit
        color = develop(total / np.maximum(covered, 1.0))
        alpha = np.rint(255 * covered / SAMPLES**2).astype(np.uint8)
        return np.concatenate([color, alpha], 1).reshape(view.height, view.width, 4)


def pose(number: int, count: int) -> npt.NDArray[np.float64]:
    """Camera to world (4, 4) in Blender's axes: on a spiral over the upper half of a sphere."""
    height = (number + 0.5) / count * 0.95
    turn = number * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - height**2)
    back = np.array([flat * np.cos(turn), flat * np.sin(turn), height])
    right = unit(np.cross([0.0, 0.0, 1.0], back)[None])[0]
    found = np.eye(4)
    found[:3] = np.stack([right, np.cross(back, right), back, CAMERA_RADIUS * back], 1)
    return found


def view_of(camera_to_world: npt.NDArray[np.float64]) -> View:
    """The same camera in the tracer's axes and metres."""
    rotation = (camera_to_world[:3, :3] * [1.0, -1.0, -1.0]).T
    centre = camera_to_world[:3, 3] / SCALE + TARGET
    focal = 0.5 * SIZE / np.tan(0.5 * FIELD_OF_VIEW)
    return View(rotation, -rotation @ centre, focal, SIZE, SIZE)


def write_capture(
    folder: Path,
    views: Mapping[str, int],
    photograph: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.uint8]],
) -> None:
    """Write the pictures, RGBA, that ``photograph`` takes of each pose; ``views``: by split."""
    for split, count in views.items():
        (folder / split).mkdir(parents=True)
        frames = []
        for number in range(count):
            name, camera_to_world = f"./{split}/r_{number}", pose(number, count)
            Image.fromarray(photograph(camera_to_world)).save(folder / f"{name}.png")
            frames.append({"file_path": name, "transform_matrix": camera_to_world.tolist()})
        description = {"camera_angle_x": FIELD_OF_VIEW, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(description))


def main(arguments: list[str]) -> int:
    """Write the capture; exit code 2 for wrong usage."""
    if len(arguments) != 1:
        print("usage: object_capture.py FOLDER", file=sys.stderr)
        return 2
    scene = GlossyScene(exhibits(), LIGHT)
    write_capture(Path(arguments[0]), VIEWS, lambda seen: scene.photograph(view_of(seen)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
