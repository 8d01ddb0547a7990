"""A pinhole camera in the OpenCV convention: x right, y down, z forward.

Of the photos that a scene was learned from, it keeps the range of distances and focal lengths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_type
from clgs.constants import FRUSTUM_MARGIN
from clgs.errors import UsageError

ORTHONORMAL = 1e-3
"""How far the products of a rotation's rows may be from those of unit axes."""


@dataclass(frozen=True)
class Camera:
    """World-to-camera pose and intrinsics: x_cam = rotation @ x_world + translation.

    rotation (3, 3) float64, translation (3,) float64 in scene units; fx, fy, cx, cy in pixels,
    pixel centres at +0.5; width, height in pixels.

    Raises:
        UsageError: a field is no such number; names it.
        TypeError: a field is of another type, such as a list; names it.
    """

    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        """See that a picture can be taken."""
        for name in ("rotation", "translation"):
            array = getattr(self, name)
            check_type(name, array, np.ndarray, "numpy.array(rows) makes one")
            if array.dtype.kind not in "iuf":
                raise TypeError(f"{name}: {array.dtype} are no numbers; give float64")
        for name in ("fx", "fy", "cx", "cy", "width", "height"):
            check_type(name, getattr(self, name), Real, "give pixels")
        if problem := _problem(self):
            raise UsageError(f"camera: {problem}")

    @property
    def centre(self) -> npt.NDArray[np.float64]:
        """Camera centre (3,) float64 in scene units."""
        return -self.rotation.T @ self.translation

    def slope_limits(self) -> npt.NDArray[np.float64]:
        """(x_min, x_max, y_min, y_max): the limits of x/z and y/z in the Jacobian.

        The frame grown by FRUSTUM_MARGIN of its size on each side; for a centred principal point
        this is the +-1.3 tan(fov/2) of 3DGS.
        """
        margin_x, margin_y = FRUSTUM_MARGIN * self.width, FRUSTUM_MARGIN * self.height
        return np.array(
            [
                (-margin_x - self.cx) / self.fx,
                (self.width + margin_x - self.cx) / self.fx,
                (-margin_y - self.cy) / self.fy,
                (self.height + margin_y - self.cy) / self.fy,
            ]
        )

    def resized(self, width: int, height: int) -> Camera:
        """The same camera on a raster of another size; each axis by its own ratio."""
        x, y = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * x,
            cx=self.cx * x,
            fy=self.fy * y,
            cy=self.cy * y,
            width=width,
            height=height,
        )

    def reduced(self, factor: int) -> Camera:
        """The camera of a picture reduced ``factor`` times; sizes are rounded, at least 1."""
        if factor == 1:
            return self
        width, height = (max(1, round(size / factor)) for size in (self.width, self.height))
        return self.resized(width, height)

    def pack(self, near: float) -> npt.NDArray[np.float32]:
        """The camera as the kernels read it, (26,) float32; layout in common/camera.h."""
        return np.concatenate(
            [
                self.rotation.ravel(),
                self.translation,
                [self.fx, self.fy, self.cx, self.cy, self.width, self.height, near],
                self.slope_limits(),
                self.centre,
            ]
        ).astype(np.float32)


def optical_axes(
    centres: npt.NDArray[np.float64], forward: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The matrix (3, 3) and the right side (3,) whose solution is the point nearest to all axes.

    ``centres`` (N, 3) and unit ``forward`` (N, 3) of cameras. The least eigenvalue of the matrix is
    0 if all axes are parallel, and 2/3 if they come from everywhere.
    """
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    return across.mean(axis=0), np.einsum("nij,nj->i", across, centres) / len(centres)


def _problem(camera: Camera) -> str:
    """What is wrong with the fields, and what they should be; empty if nothing is."""
    sizes = camera.width, camera.height
    if not all(isinstance(size, Integral) and size >= 1 for size in sizes):
        return f"width, height are {sizes[0]}, {sizes[1]}; give whole numbers of at least 1"
    if not (0 < camera.fx < np.inf and 0 < camera.fy < np.inf):
        return f"fx, fy are {camera.fx}, {camera.fy}; give pixels, above 0"
    rotation, translation = camera.rotation, camera.translation
    if rotation.shape != (3, 3) or translation.shape != (3,):
        found = f"{rotation.shape}, {translation.shape}"
        return f"rotation, translation have the shapes {found}; give (3, 3), (3,)"
    if not np.isfinite([camera.cx, camera.cy, *translation]).all():
        return "cx, cy or translation is not finite; correct it"
    if not np.abs(rotation @ rotation.T - np.eye(3)).max() <= ORTHONORMAL:
        return "rotation is none: its rows are not unit axes; correct it"
    if np.linalg.det(rotation) < 0:
        return "rotation mirrors; turn one axis round"
    return ""


SLACK = 0.01
"""Share by which the distances are widened: cameras next to those of the photos count as theirs."""

PULL = 1e-3
"""How strongly the point between cameras is drawn to their middle, for axes that are parallel."""


class PhotoRange(NamedTuple):
    """Bounds of what all photos have in common.

    least_focal, greatest_focal: of fx and fy, pixels; x, y, z: the point nearest to all optical
    axes, scene units; nearest, farthest: distances of cameras from it, scene units. All are 0 if
    nothing is known of the photos.
    """

    least_focal: float = 0.0
    greatest_focal: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    nearest: float = 0.0
    farthest: float = 0.0

    def problem(self) -> str:
        """Which numbers make no sense, or empty."""
        focal, reach = (self.least_focal, self.greatest_focal), (self.nearest, self.farthest)
        limit = 2.0**64
        if not all(math.isfinite(value) and abs(value) <= limit for value in self):
            return "a number is not finite, or beyond 2^64"
        if self != UNKNOWN and not 2.0**-64 <= focal[0] <= focal[1]:
            return f"focal lengths from {focal[0]} to {focal[1]}"
        return "" if 0 <= reach[0] <= reach[1] else f"distances from {reach[0]} to {reach[1]}"


UNKNOWN = PhotoRange()


def photo_range(cameras: Sequence[Camera]) -> PhotoRange:
    """The bounds of photos by ``cameras``, in their units; UNKNOWN if there are none."""
    if not cameras:
        return UNKNOWN
    centres = np.array([camera.centre for camera in cameras])
    forward = np.array([camera.rotation[2] for camera in cameras])
    matrix, right = optical_axes(centres, forward)
    point = np.linalg.solve(matrix + PULL * np.eye(3), right + PULL * centres.mean(axis=0))
    distance = np.linalg.norm(centres - point, axis=1)
    focal = [value for camera in cameras for value in (camera.fx, camera.fy)]
    reach = distance.min() * (1 - SLACK), distance.max() * (1 + SLACK)
    return PhotoRange(min(focal), max(focal), *point.tolist(), *map(float, reach))
