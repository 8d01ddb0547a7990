"""The demonstration's still life: a gallery corner built of scikit-image's bundled photographs.

Only pictures that come inside scikit-image's wheel are used, so nothing is downloaded.
Metres, z up; the corner of the two walls is at (-2.4, 2.4), the visitor stands at +x, -y.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import numpy.typing as npt
from raytrace import GAMMA, Light, Place, RayScene, Surface

TEXELS_PER_METRE = 75
"""Somewhat below the photos' 87 pixels a metre at the objects: fine detail would only alias."""

Floats = npt.NDArray[np.float64]
Vector = Sequence[float]
RGB = tuple[float, float, float]
WHITE: RGB = (1.0, 1.0, 1.0)

LIGHT = Light(
    towards_sun=np.array([0.72, -0.26, 0.6433]),
    sun=np.float32([1.30, 1.20, 1.04]),
    sky=np.float32([0.40, 0.45, 0.53]),
    ground=np.float32([0.28, 0.25, 0.22]),
    sun_radius=0.025,
)


@cache
def photograph(name: str) -> npt.NDArray[np.uint8]:
    """One of scikit-image's bundled photographs, (h, w, 3)."""
    from skimage import data

    if name == "motorcycle":
        return np.asarray(data.stereo_motorcycle()[0])
    picture = np.asarray(getattr(data, name)())
    if name == "brick":
        picture = np.rot90(picture)  # its courses run upwards
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def paint(
    name: str, size: Vector, tint: RGB = WHITE, contrast: float = 1.0, gain: float = 1.0
) -> npt.NDArray[np.float32]:
    """Linear albedo of photograph ``name``, cropped to size (width, height) in metres.

    tint multiplies, contrast scales around the mean (linear), gain brightens.
    """
    from PIL import Image

    source = photograph(name)
    height, width = source.shape[:2]
    scale = min(width / size[0], height / size[1])
    half_x, half_y = scale * size[0] / 2, scale * size[1] / 2
    left, upper = max(width / 2 - half_x, 0), max(height / 2 - half_y, 0)
    box = (left, upper, width - left, height - upper)
    texels = tuple(max(4, round(side * TEXELS_PER_METRE)) for side in size)
    small = Image.fromarray(source).resize(texels, Image.Resampling.LANCZOS, box=box)
    linear = (np.asarray(small, np.float32) / 255) ** GAMMA
    mean = linear.mean((0, 1))
    return np.clip(gain * (mean + contrast * (linear - mean)) * np.float32(tint), 0.01, 0.9)


def grid(columns: int, rows: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """uv (P, 2) and faces (F, 3) of a regular triangulation of the unit square."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, below = corner + 1, corner + columns + 1
    faces = np.concatenate(
        [np.stack([corner, below, right], 1), np.stack([right, below, below + 1], 1)]
    )
    return np.stack([u.ravel(), v.ravel()], 1), faces


def plane(origin: Vector, across: Vector, down: Vector) -> Place:
    """Parallelogram: u along ``across``, v along ``down``; seen from its front u runs right."""
    start, right, below = (np.asarray(vector, np.float64) for vector in (origin, across, down))
    normal = np.cross(below, right)
    normal /= np.linalg.norm(normal)

    def place(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        return start + u[:, None] * right + v[:, None] * below, np.tile(normal, (len(u), 1))

    return place


def panel(name: str, origin: Vector, across: Vector, down: Vector, **look: float | RGB) -> Surface:
    """A flat picture with its upper left corner at ``origin``."""
    size = (float(np.linalg.norm(across)), float(np.linalg.norm(down)))
    return Surface(plane(origin, across, down), *grid(1, 1), paint(name, size, **look))


def box(
    names: Sequence[str], base: Vector, size: Vector, turn: float, **look: float | RGB
) -> list[Surface]:
    """A box standing on the centre of its ``base``, turned by ``turn`` degrees.

    names: pictures of the front (-y), right (+x), back, left and top, repeated as needed.
    """
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    x, y, z = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    wide, deep, high = size
    top = np.asarray(base, np.float64) + z * high
    low = -z * high
    sides = [
        (-x * wide / 2 - y * deep / 2, x * wide, low),
        (x * wide / 2 - y * deep / 2, y * deep, low),
        (x * wide / 2 + y * deep / 2, -x * wide, low),
        (-x * wide / 2 + y * deep / 2, -y * deep, low),
        (-x * wide / 2 + y * deep / 2, x * wide, -y * deep),
    ]
    return [
        panel(names[i % len(names)], top + corner, across, down, **look)
        for i, (corner, across, down) in enumerate(sides)
    ]


def disc(rings: int, spokes: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """uv (P, 2) and faces (F, 3) of the circle inside the unit square."""
    polar, faces = grid(spokes, rings)
    angle = 2 * np.pi * polar[:, 0]
    circle = polar[:, 1:] * np.stack([np.cos(angle), np.sin(angle)], 1)
    return 0.5 + 0.5 * circle, faces


def ball(name: str, centre: Vector, radius: float, **look: float | RGB) -> Surface:
    """A sphere wrapped in the inner circle of a picture, whose centre faces the visitor.

    Lambert's equal-area projection, its one singular point on the far side.
    """
    middle = np.asarray(centre, np.float64)
    facing = np.array([0.65, -0.65, 0.39]) / np.linalg.norm([0.65, -0.65, 0.39])
    right = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    down = np.cross(facing, right) * -1

    def place(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        flat = 2 * np.stack([u, v], 1) - 1
        square = np.minimum((flat**2).sum(1, keepdims=True), 1)
        normal = (1 - 2 * square) * facing
        normal += 2 * np.sqrt(1 - square) * (flat @ np.stack([right, down]))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return middle + radius * normal, normal

    return Surface(place, *disc(40, 96), paint(name, (4 * radius, 4 * radius), **look))


def drum(
    name: str, lid: str, base: Vector, radius: float, height: float, turn: float
) -> list[Surface]:
    """A cylinder wrapped in a picture, with another on its lid."""
    foot = np.asarray(base, np.float64)

    def place(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        angle = 2 * np.pi * u + np.radians(turn)
        normal = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
        return foot + radius * normal + np.outer(height * (1 - v), [0, 0, 1]), normal

    wrap = Surface(place, *grid(96, 1), paint(name, (2 * np.pi * radius, height)))
    corner = foot + np.array([-radius, radius, height])
    flat = plane(corner, (2 * radius, 0, 0), (0, -2 * radius, 0))
    return [wrap, Surface(flat, *disc(1, 96), paint(lid, (2 * radius, 2 * radius)))]


def framed(name: str, centre: Vector, across: Vector, height: float) -> list[Surface]:
    """A photograph in a dark frame, a hand's breadth off its wall."""
    right = np.asarray(across, np.float64)
    width = float(np.linalg.norm(right))
    right /= width
    up, out = np.array([0.0, 0.0, 1.0]), np.cross(right, [0.0, 0.0, 1.0])
    middle = np.asarray(centre, np.float64)
    rim = 0.09
    turn = np.degrees(np.arctan2(right[1], right[0]))
    outer = (width + 2 * rim, 0.08, height + 2 * rim)
    foot = middle + 0.04 * out - up * outer[2] / 2
    corner = middle + 0.086 * out - right * width / 2 + up * height / 2
    frame = box(["gravel"], foot, outer, turn, tint=(0.30, 0.20, 0.13), contrast=0.5)
    return [*frame, panel(name, corner, right * width, -up * height)]


def room() -> list[Surface]:
    """Floor, rug and two walls with pictures; they fill every view."""
    floor = panel(
        "gravel",
        (-2.4, 2.4, 0),
        (8.4, 0, 0),
        (0, -8.4, 0),
        tint=(1.0, 0.88, 0.74),
        contrast=0.55,
        gain=1.5,
    )
    rug = panel(
        "immunohistochemistry",
        (-0.6, 1.75, 0.015),
        (2.0, -2.0, 0),
        (-1.55, -1.55, 0),
        tint=(1.0, 0.86, 0.74),
        gain=0.8,
    )
    back = panel("hubble_deep_field", (-2.4, 2.4, 4.2), (8.4, 0, 0), (0, 0, -4.2), gain=1.4)
    left = panel(
        "brick",
        (-2.4, -6.0, 4.2),
        (0, 8.4, 0),
        (0, 0, -4.2),
        tint=(1.0, 0.62, 0.45),
        contrast=0.8,
        gain=1.6,
    )
    return [
        floor,
        rug,
        back,
        left,
        *framed("motorcycle", (-2.4, -0.15, 1.75), (0, 1.9, 0), 1.25),
        *framed("rocket", (0.55, 2.4, 1.75), (1.7, 0, 0), 1.15),
    ]


def exhibits() -> list[Surface]:
    """The objects in the middle."""
    stone = {"tint": (1.0, 0.97, 0.92), "contrast": 0.4, "gain": 1.6}
    moon = {"contrast": 2.5, "gain": 1.7}
    return [
        *box(["gravel"], (-0.35, 0.45, 0), (1.25, 1.25, 0.4), 30, **stone),
        *box(
            ["astronaut", "coffee", "rocket", "motorcycle", "astronaut"],
            (-0.35, 0.45, 0.4),
            (0.9, 0.9, 0.9),
            52,
        ),
        *box(
            ["chelsea", "astronaut", "brick", "rocket", "coffee"],
            (-0.35, 0.45, 1.3),
            (0.62, 0.5, 0.45),
            22,
        ),
        *drum("motorcycle", "coins", (1.2, 1.0, 0), 0.42, 0.6, 135),
        ball("moon", (1.2, 1.0, 1.0), 0.4, **moon),
        *box(
            ["coffee", "chelsea", "rocket", "coffee", "chelsea"],
            (-1.05, -1.05, 0),
            (0.95, 0.7, 0.55),
            68,
        ),
        ball("retina", (-1.05, -1.05, 0.83), 0.28),
        *drum("immunohistochemistry", "coffee", (0.75, -0.75, 0.0), 0.3, 0.38, 135),
    ]


def build() -> RayScene:
    """The whole scene, lit and ready to photograph."""
    return RayScene([*room(), *exhibits()], LIGHT)
