"""Distances and focal lengths of the photos that a scene was learned from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clgs.scene.camera import Camera, optical_axes

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
