"""Paths of cameras: around a scene, on a spiral before it, through given cameras, or from a file.

Files are JSON in nerfstudio's form. ``camera_path`` is a list of ``camera_to_world`` (16 numbers,
row-major, OpenGL's axes: x right, y up, z backward), ``fov`` (vertical, degrees) and ``aspect``;
the file also has ``render_width``, ``render_height`` and ``fps``. Without that list the
``keyframes`` are taken. Their ``matrix`` is by rows if its last row is (0, 0, 0, 1); older viewers
wrote it by columns. Source: the documentation of nerfstudio's viewer.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from clgs.arguments import plain_numbers
from clgs.errors import DataError
from clgs.exports.framing import Framing, Vector, fov_y
from clgs.files import atomic_write
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


MAX_BYTES = 64 * 2**20
MAX_SIZE = 16384
POSES = "camera_to_world", "matrix"
"""Fields that hold a pose; the first that a frame has is taken."""

FARTHEST = 1e12
"""The largest distance from the origin, in world units; cameras of data sets have the same one."""
DEFAULT_SIZE = 800, 600
FLIP = np.diag([1.0, -1.0, -1.0])
"""Turns OpenGL's axes of a camera into OpenCV's, and back."""


def read_camera_path(path: Path) -> tuple[list[Camera], float | None]:
    """The cameras of a file, at least one, in the data set's world units, and frames per second.

    Raises:
        DataError: no such file, or not a path of perspective cameras; names the field.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path}: larger than {MAX_BYTES >> 20} MiB; this is no camera path")
        record = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise DataError(
            f"{path}: no such file; name a camera path, orbit, spiral or interpolate"
        ) from None
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; name a .json file") from None
    except (ValueError, RecursionError):
        raise DataError(f"{path}: not a JSON file; export the camera path again") from None
    try:
        return _parse(record)
    except _PathError as problem:
        raise DataError(f"{path}: {problem}") from None


class _PathError(Exception):
    """What is wrong with a file, and the remedy."""


def _parse(record: Any) -> tuple[list[Camera], float | None]:
    if not isinstance(record, dict):
        raise _PathError("not an object with the list camera_path; export the camera path again")
    kind = record.get("camera_type", "perspective")
    if kind != "perspective":
        raise _PathError(f"camera_type: {str(kind)[:40]!r}; perspective cameras alone are rendered")
    width = _number(record, "render_width", DEFAULT_SIZE[0], 1, MAX_SIZE)
    height = _number(record, "render_height", DEFAULT_SIZE[1], 1, MAX_SIZE)
    fps = _number(record, "fps", 0.0, 0.0, 1000.0)
    name = "camera_path" if record.get("camera_path") else "keyframes"
    frames = record.get(name)
    if not isinstance(frames, list) or not frames:
        raise _PathError("camera_path: has no cameras; add some and export it again")
    size = round(width), round(height)
    cameras = [_camera(frame, f"{name}[{i}]", size) for i, frame in enumerate(frames)]
    return cameras, fps or None


def _camera(frame: Any, where: str, size: tuple[int, int]) -> Camera:
    if not isinstance(frame, dict):
        raise _PathError(f"{where}: not an object")
    # camera to world (4, 4), its rotation made exact
    field = next((name for name in POSES if name in frame), POSES[0])
    value = frame.get(field)
    try:
        found = json.loads(value) if isinstance(value, str) else value
        flat = np.array(plain_numbers(found), np.float64).ravel()
    except (TypeError, ValueError, RecursionError):
        flat = np.empty(0)
    if flat.size not in (12, 16) or not (np.abs(flat) < FARTHEST).all():
        raise _PathError(f"{where}.{field}: 16 numbers below {FARTHEST:g} are needed")
    pose = np.eye(4)
    pose[: flat.size // 4] = flat.reshape(-1, 4)
    if field == "matrix" and pose[3, :3].any():
        pose = pose.T
    left, stretch, right = np.linalg.svd(pose[:3, :3])
    if stretch[2] < 0.5 * stretch[0] or stretch[0] < 1e-6 or np.linalg.det(left @ right) < 0:
        raise _PathError(f"{where}.{field}: its rotation is none; export the camera path again")
    pose[:3, :3] = left @ right
    fov = _number(frame, "fov", 50.0, 0.1, 179.0, where)
    aspect = _number(frame, "aspect", size[0] / size[1], 1e-3, 1e3, where)
    if math.isclose(aspect, size[0] / size[1], rel_tol=0.02):
        aspect = 0.0  # rounded to whole pixels
    return pinhole(FLIP @ pose[:3, :3].T, pose[:3, 3], fov, size, aspect)


def _number(
    record: dict[str, Any], name: str, default: float, least: float, most: float, where: str = ""
) -> float:
    value = record.get(name, default)
    field = f"{where}.{name}" if where else name
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise _PathError(f"{field}: {str(value)[:40]} is not a number from {least:g} to {most:g}")
    return float(value)


def write_camera_path(path: Path, cameras: Sequence[Camera], fps: float) -> None:
    """Write ``cameras``, in world units and of one size, as :func:`read_camera_path` reads them.

    Raises:
        OutputError, OSError: as of :func:`clgs.files.atomic_write`.
    """
    frames = []
    for camera in cameras:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.rotation.T @ FLIP, camera.centre
        aspect = (camera.width / camera.fx) / (camera.height / camera.fy)
        frames.append(
            {"camera_to_world": pose.ravel().tolist(), "fov": fov_y(camera), "aspect": aspect}
        )
    record = {
        "camera_type": "perspective",
        "render_width": cameras[0].width,
        "render_height": cameras[0].height,
        "fps": fps,
        "seconds": len(cameras) / fps,
        "camera_path": frames,
        "keyframes": [],
        "is_cycle": False,
    }
    atomic_write(path, json.dumps(record, indent=1).encode())
