"""Random initial points, for a data set without points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.scene.camera import Camera

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BLENDER_HALF_EDGE = 1.3
"""Half the edge of the cube around the origin that holds every Synthetic-NeRF object."""

BLENDER_DISTANCE, BLENDER_TOLERANCE = 4.0, 1.5
"""How far the cameras of Synthetic-NeRF are from the origin. Scenes that are smaller or larger by
more than the tolerance are scaled to that."""

HULL_POINTS = 10_000
"""Random points in the visual hull of a Blender scene; anchors grow from there."""

RAY_POINTS = 100_000
"""Random points among photos, most of them in empty space."""

SEEN_SHARE = 0.5
"""A random point must lie in the image of at least this share of the cameras; if none does, as in a
room photographed from its middle, of two cameras."""

MASK_MARGIN = 2
"""Pixels by which alpha masks are grown before points are carved with them."""

_BATCH = 200_000
_MAX_BATCHES = 20


@dataclass(frozen=True)
class Viewpoint:
    """A camera and, if its image has alpha, the grown mask (H, W) of what is not background."""

    camera: Camera
    mask: Mask | None


def viewpoint(camera: Camera, alpha: npt.NDArray[np.uint8] | None) -> Viewpoint:
    """The camera with its mask alpha > 0 grown by MASK_MARGIN pixels."""
    if alpha is None:
        return Viewpoint(camera, None)
    from scipy.ndimage import maximum_filter  # not needed by most data sets

    return Viewpoint(camera, maximum_filter(alpha, size=2 * MASK_MARGIN + 1) > 0)


def random_points(
    viewpoints: list[Viewpoint], radius: float, blender: bool, seed: int, count: int, carved: bool
) -> npt.NDArray[np.float32]:
    """About ``count`` points (P, 3) float32 in the volume that the cameras share.

    A point is kept if at least SEEN_SHARE of the cameras, or else two of them, have it in their
    image and none of those shows background there; P is 0 if there is none. ``blender``: drawn
    in the cube of Synthetic-NeRF, unless no camera sees it; else along random viewing rays at
    depths of 0.2 to 5 times ``radius``. Scene units. ``count`` 0: HULL_POINTS in Blender scenes,
    RAY_POINTS among photos. Not ``carved``, the points of a Blender scene fill its cube,
    background or not (Voxel-GS).
    """
    rng = np.random.default_rng(seed)
    count = count or (HULL_POINTS if blender else RAY_POINTS)
    if blender and not carved:
        edge = BLENDER_HALF_EDGE
        return rng.uniform(-edge, edge, (count, 3)).astype(np.float32)
    most = math.ceil(SEEN_SHARE * len(viewpoints))
    points = _in_cube(rng, viewpoints, most, count) if blender else np.empty((0, 3))
    for needed in (most, min(2, most)):
        if not len(points):
            draw = partial(_on_rays, rng, viewpoints, radius)
            points = _collect(draw, viewpoints, needed, count)
    return points[:count].astype(np.float32)


def _collect(
    draw: Callable[[], Floats], viewpoints: list[Viewpoint], needed: int, count: int
) -> Floats:
    """Batches of ``draw`` carved until ``count`` are left, or none ever is."""
    kept: list[Floats] = []
    for _ in range(_MAX_BATCHES):
        points = draw()
        kept.append(points[_shared(points, viewpoints, needed)])
        found = sum(map(len, kept))
        if found == 0 or found >= count:
            break
    return np.concatenate(kept)


def _in_cube(
    rng: np.random.Generator, viewpoints: list[Viewpoint], needed: int, count: int
) -> Floats:
    """Points of the cube of Synthetic-NeRF; after a first look only of the part that is full."""
    low, high = np.full(3, -BLENDER_HALF_EDGE), np.full(3, BLENDER_HALF_EDGE)
    first = rng.uniform(low, high, (_BATCH, 3))
    first = first[_shared(first, viewpoints, needed)]
    if not len(first):
        return first
    margin = 0.05 * (first.max(axis=0) - first.min(axis=0)) + 0.01
    low = np.maximum(low, first.min(axis=0) - margin)
    high = np.minimum(high, first.max(axis=0) + margin)
    return _collect(lambda: rng.uniform(low, high, (_BATCH, 3)), viewpoints, needed, count)


def _on_rays(rng: np.random.Generator, viewpoints: list[Viewpoint], radius: float) -> Floats:
    """Points of random pixels of random cameras, depth log-uniform."""
    depth = radius * np.exp(rng.uniform(np.log(0.2), np.log(5.0), _BATCH))
    owner = rng.integers(len(viewpoints), size=_BATCH)
    pixel = rng.uniform(size=(_BATCH, 2))
    points = np.empty((_BATCH, 3))
    for number, viewpoint_ in enumerate(viewpoints):
        mine, camera = owner == number, viewpoint_.camera
        at = pixel[mine] * (camera.width, camera.height)
        ray = (at - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        local = np.column_stack([ray, np.ones(len(ray))]) * depth[mine, None]
        points[mine] = (local - camera.translation) @ camera.rotation
    return points


def _shared(points: Floats, viewpoints: list[Viewpoint], needed: int) -> Mask:
    """Which points (P, 3) ``needed`` cameras see and none sees through."""
    alive = np.arange(len(points))
    seen = np.zeros(len(points), np.int64)
    for viewpoint_ in viewpoints:
        # whether points (P, 3) fall into the image, and the column and row (P,) of those that do
        camera = viewpoint_.camera
        local = points[alive] @ camera.rotation.T + camera.translation
        ahead = local[:, 2] > 1e-6
        depth = np.where(ahead, local[:, 2], 1.0)
        x = local[:, 0] / depth * camera.fx + camera.cx
        y = local[:, 1] / depth * camera.fy + camera.cy
        inside = ahead & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        column = np.where(inside, x, 0.0).astype(np.int64)
        row = np.where(inside, y, 0.0).astype(np.int64)
        seen[alive] += inside
        if viewpoint_.mask is not None:
            alive = alive[~inside | viewpoint_.mask[row, column]]
    kept = np.zeros(len(points), bool)
    kept[alive] = seen[alive] >= needed
    return kept
