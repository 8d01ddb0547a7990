"""Paths of cameras: around a scene, on a spiral before it, or through given cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from clgs.exports.clip.framing import Framing, Vector
from clgs.scene.camera import Camera

SPIRAL_TURNS = 2
SPIRAL_SHARE = 0.15
"""Radius of a spiral as a share of the distance to the centre, at most."""

FRAMES_BY_KEY, LEAST_KEYS = 8, 12
"""A path through photos has a photo every FRAMES_BY_KEY frames, as more would make a shaky walk,
but at least LEAST_KEYS photos, as the way between fewer would cut through things."""


def pinhole(
    rotation: Vector, centre: Vector, fov: float, size: tuple[int, int], aspect: float = 0.0
) -> Camera:
    """A camera at ``centre`` (3,), its principal point in the middle; ``fov``: vertical, degrees.

    rotation: (3, 3) world to camera, OpenCV's axes; size: (width, height), pixels; aspect: width
    over height of the picture if pixels are not square, else 0.
    """
    width, height = size
    fy = float(height / (2 * np.tan(np.radians(fov) / 2)))
    fx = fy * width / (height * aspect) if aspect else fy
    return Camera(rotation, -rotation @ centre, fx, fy, width / 2, height / 2, width, height)


def look_at(eye: Vector, target: Vector, up: Vector) -> npt.NDArray[np.float64]:
    """World to camera (3, 3), OpenCV's axes, of a camera at ``eye`` that looks at ``target``."""
    forward = target - eye
    forward = forward / (np.linalg.norm(forward) or 1.0)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:  # it looks straight up or down
        right = np.cross(forward, np.roll(up, 1) + 0.1)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def orbit(framing: Framing, frames: int) -> list[Camera]:
    """Around the centre; to and fro if the ring is open. The last frame leads to the first one."""
    turn = 2 * np.pi * np.arange(frames) / frames
    first, last = framing.arc
    angles = turn + first if framing.closed else first + (last - first) * (1 - np.cos(turn)) / 2
    return [_towards_centre(framing, framing.place(angle)) for angle in angles]


def spiral(framing: Framing, frames: int) -> list[Camera]:
    """Small circles before the centre, nearer and farther; it ends where it began."""
    middle = framing.place(sum(framing.arc) / 2 if not framing.closed else framing.arc[0])
    right, down, forward = look_at(middle, framing.centre, framing.up)
    distance = float(np.linalg.norm(framing.centre - middle))
    half_arc = (framing.arc[1] - framing.arc[0]) / 2
    radius = distance * min(SPIRAL_SHARE, max(0.02, 0.5 * half_arc))
    cameras = []
    for share in np.arange(frames) / frames:
        turn = 2 * np.pi * SPIRAL_TURNS * share
        step = np.cos(turn) * right - 0.6 * np.sin(turn) * down
        step = step + 0.5 * np.sin(2 * np.pi * share) * forward
        cameras.append(_towards_centre(framing, middle + radius * step))
    return cameras


def _towards_centre(framing: Framing, eye: Vector) -> Camera:
    rotation = look_at(eye, framing.centre, framing.up)
    return pinhole(rotation, eye, framing.fov, framing.size)


def through_photos(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """Through photos: some of ``cameras``, evenly spread, in an order that makes a short way."""
    ordered = [cameras[i] for i in walking_order(np.array([c.centre for c in cameras]))]
    keys = min(len(ordered), max(LEAST_KEYS, frames // FRAMES_BY_KEY))
    chosen = np.unique(np.rint(np.linspace(0, len(ordered) - 1, keys)).astype(int))
    return interpolate([ordered[i] for i in chosen], frames)


def interpolate(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """A smooth way through all of ``cameras`` in their order, at an even pace.

    Each frame has the raster of the first one. Places are on a cubic spline, turns on one of
    rotations with continuous speed, lenses between.
    """
    first = cameras[0]
    focal = np.array([[c.fx / c.width, c.fy / c.height] for c in cameras])
    if len(cameras) == 1:
        return [first] * frames
    centres = np.array([camera.centre for camera in cameras])
    turns = Rotation.from_matrix(np.array([camera.rotation.T for camera in cameras]))
    # ascending times (N,)
    far = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    turned = (turns[:-1].inv() * turns[1:]).magnitude()
    step = far / (far.mean() or 1.0) + turned / (np.pi / 4)
    time = np.append(0.0, np.cumsum(np.maximum(step, 1e-3)))
    at = np.linspace(time[0], time[-1], frames)
    # a natural end keeps the spline from swinging out beyond its first and last camera
    places = CubicSpline(time, centres, bc_type="natural")(at)
    rotations = RotationSpline(time, turns)(at).as_matrix()
    lens = np.stack([np.interp(at, time, focal[:, axis]) for axis in range(2)], 1)
    width, height = first.width, first.height
    return [
        Camera(
            *(turn.T, -turn.T @ place, fx * width, fy * height),
            *(width / 2, height / 2, width, height),
        )
        for turn, place, (fx, fy) in zip(rotations, places, lens, strict=True)
    ]


def walking_order(centres: Vector) -> list[int]:
    """Indices in an order that makes a short way.

    As given, as photos of a walk are; or, if that is much shorter, always to the nearest that is
    left, from the one farthest from the mean.
    """
    given = list(range(len(centres)))
    left = set(given)
    at = int(np.argmax(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))
    greedy = [at]
    left.discard(at)
    while left:
        rest = np.array(sorted(left))
        at = int(rest[np.argmin(np.linalg.norm(centres[rest] - centres[at], axis=1))])
        greedy.append(at)
        left.discard(at)
    return given if _length(centres[given]) <= 1.5 * _length(centres[greedy]) else greedy


def _length(places: Vector) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
