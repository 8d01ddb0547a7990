"""Cameras to bake from if there is no data set: what is stored says little about its cameras.

A data set of photos is scaled so that its cameras lie within SCENE_RADIUS / RADIUS_MARGIN of the
origin, the farthest at that distance. Cameras to bake from stand on two spheres within, and look at
the middle of the anchors. A scene of Blender keeps its units: cameras stand around the anchors, far
enough to see them all.
"""

from __future__ import annotations

import numpy as np

from clgs.data.dataset import RADIUS_MARGIN, SCENE_RADIUS
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene

VIEWS = 96
SIZE = 400
"""Pixels of an edge."""
FIELD = 0.7
"""Radians across."""
SHELLS = (1.0, 0.6)
"""Radii of the spheres that cameras stand on in turn, in units of the largest."""
MOST_ANCHORS = 0.9
"""Share of the anchors that cameras are to see."""


def cameras_around(scene: Scene) -> list[Camera]:
    """VIEWS cameras in scene units, evenly spread; always the same ones for a scene."""
    position = scene.anchors.position.astype(np.float64)
    middle = np.median(position, axis=0)
    if scene.transform.is_identity:
        extent = np.quantile(np.linalg.norm(position - middle, axis=1), MOST_ANCHORS)
        stand, radius = middle, float(extent) / np.sin(FIELD / 2)
    else:
        stand, radius = np.zeros(3), SCENE_RADIUS / RADIUS_MARGIN
    # equal steps of height, turned by the golden angle
    height = 1 - (2 * np.arange(VIEWS) + 1) / VIEWS
    angle = np.arange(VIEWS) * np.pi * (3 - np.sqrt(5))
    around = np.sqrt(1 - height**2)
    directions = np.column_stack([around * np.cos(angle), around * np.sin(angle), height])
    shells = radius * np.resize(SHELLS, VIEWS)
    cameras, focal, half = [], SIZE / 2 / np.tan(FIELD / 2), SIZE / 2
    for r, direction in zip(shells, directions, strict=True):
        centre = stand + r * direction
        forward = middle - centre
        forward /= max(float(np.linalg.norm(forward)), 1e-9)
        side = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])  # any side may be up
        side /= max(float(np.linalg.norm(side)), 1e-9)
        rotation = np.stack([side, np.cross(forward, side), forward])
        place = focal, focal, half, half, SIZE, SIZE
        cameras.append(Camera(rotation, -rotation @ centre, *place))
    return cameras
