"""Camera paths as JSON files in nerfstudio's form.

``camera_path`` is a list of ``camera_to_world`` (16 numbers, row-major, OpenGL's axes: x right, y
up, z backward), ``fov`` (vertical, degrees) and ``aspect``; the file also has ``render_width``,
``render_height`` and ``fps``. Without that list the ``keyframes`` are taken. Their ``matrix`` is by
rows if its last row is (0, 0, 0, 1); older viewers wrote it by columns.
Source: the documentation of nerfstudio's viewer.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clgs.errors import DataError
from clgs.exports.clip.framing import fov_y
from clgs.exports.clip.paths import pinhole
from clgs.files import atomic_write
from clgs.quantities import plain_numbers
from clgs.scene.camera import Camera

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
