"""How much each anchor shows: opacity times area of its Gaussians, with no device.

Used to order anchors into layers. This order gives better pictures of a small share of them than
their own sizes do, and than what leaving one of them out costs (docs/benchmarks/layers.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS
from clgs.reference import mlp, neural
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene

BATCH = 8192
"""Anchors that are decoded at once."""

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
FAR = 3.0
"""Without cameras, eyes look from these directions, this many times as far as most anchors."""

MOST = 0.9
"""Share of the anchors that is most of them."""

MARGIN = 0.15
"""What lies outside of a picture by this share of its size counts as seen."""

Floats = npt.NDArray[np.float64]


def contribution(scene: QuantizedScene, cameras: Sequence[Camera] = ()) -> Floats:
    """The sum (A,) float64 over all cameras of opacity times area of an anchor's Gaussians.

    The area is the product of the two largest scales of a Gaussian: in square pixels, as far as the
    camera sees its centre; without cameras in square scene units, for eyes all around.
    """
    anchors, settings = scene.anchors, scene.settings
    total = np.zeros(len(anchors))
    if not len(anchors):
        return total
    floats = scene.dequantize()
    middle = np.median(floats.anchors.position.astype(np.float64), axis=0)
    away = np.quantile(np.linalg.norm(floats.anchors.position - middle, axis=1), MOST)
    eyes = [camera.centre for camera in cameras] or list(middle + FAR * away * CORNERS)
    weights = floats.mlps.flat.astype(np.float64)
    for start in range(0, len(anchors), BATCH):
        batch = slice(start, start + BATCH)
        position, offset, feature, scaling = (
            array[batch].astype(np.float64) for _, array in floats.anchors.items()
        )
        visible = np.arange(len(position), dtype=np.int32)
        for number, eye in enumerate(eyes):
            packed = np.zeros(mlp.CENTRE.stop)
            packed[mlp.CENTRE] = eye
            output = mlp.forward(feature, position, visible, weights, packed).output
            made = neural.forward(output, visible, position, offset, scaling)
            shown = np.clip(made.opacity, 0, 1) * np.sort(made.scale, axis=1)[:, 1:].prod(axis=1)
            if cameras:
                shown *= _pixels(made.mean, cameras[number], settings.near, made.scale)
            shown = np.nan_to_num(shown, nan=0.0)
            total[batch] += np.bincount(made.slot // K_OFFSETS, shown, len(position))
    return total


def _pixels(mean: Floats, camera: Camera, near: float, scale: Floats) -> Floats:
    """Square pixels per square scene unit at ``mean`` (N, 3), 0 outside of the picture.

    No Gaussian of these ``scale`` (N, 3) covers more than the picture.
    """
    x, y, depth = (mean @ camera.rotation.T + camera.translation).T
    deep = np.maximum(depth, near)
    sides = ((x, camera.fx, camera.cx, camera.width), (y, camera.fy, camera.cy, camera.height))
    seen = depth > near
    for at, focal, centre, size in sides:
        pixel = at * focal / deep + centre
        seen &= (pixel > -MARGIN * size) & (pixel < (1 + MARGIN) * size)
    area = np.sort(scale, axis=1)[:, 1:].prod(axis=1)
    most = camera.width * camera.height / np.maximum(area, 1e-300)
    return np.where(seen, np.minimum(camera.fx * camera.fy / deep**2, most), 0.0)
