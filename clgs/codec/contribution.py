"""How much each anchor shows, and so which layer of a file it is in: the most useful come first.

An anchor shows the opacity times the area of its Gaussians, with no device. This order gives better
pictures of a small share of the anchors than their own sizes do, and than what leaving one of them
out costs (docs/benchmarks/layers.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clgs.codec.fit_size import anchor_bits
from clgs.constants import K_OFFSETS
from clgs.errors import UsageError
from clgs.options import MAX_LAYERS
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


FIRST = 0.05
"""Share of the anchors' bits in the first layer, if there are several.

With what every layer needs, such as the MLPs, it is about a tenth of a file of 400 kB.
"""

STEPS, LEAST = 1024, 1e-9
"""Ranks are multiples of 1 / STEPS of a factor of two; a share LEAST of the most is as nothing."""

TINY = 1e-300

CHUNK = 1024
"""Anchors per chunk of a layer by default: few enough that a view asks for a part of a layer."""


def choose_layers(
    scene: QuantizedScene,
    count: int,
    importance: npt.NDArray[np.float64] | None = None,
    details: int = 0,
) -> npt.NDArray[np.intp]:
    """The layer (A,), from 0 on, of each anchor, by ``importance`` (A,) per bit of its cost.

    The bits of all layers up to one grow by the same factor from layer to layer, from FIRST on. By
    default it is ``contribution`` as seen from all around. ``details``: layers without anchors that
    follow; the error of too many layers counts them.

    Raises:
        UsageError: there are fewer anchors than layers, or the number is out of range.
    """
    anchors = len(scene.anchors)
    if not 1 <= count <= min(MAX_LAYERS, anchors):
        raise UsageError(
            f"layers: {count + details}; 1 to {MAX_LAYERS} are possible, each of 1 anchor at least"
            f"{' but the last' * details}, and there are {anchors}"
        )
    if importance is None:
        importance = contribution(scene)
    bits = anchor_bits(scene.anchors)
    # Rounded, so that sums whose last bits depend on the machine give the same file on all.
    least = max(LEAST * float(importance.max()), TINY)
    rank = np.rint(STEPS * np.log2(np.maximum(importance, least) / bits))
    order = np.argsort(-rank, kind="stable")
    ends = FIRST ** np.linspace(1, 0, count)[:-1]
    total = np.cumsum(bits[order])
    first = np.searchsorted(total, ends * total[-1])
    # At least one anchor for each layer.
    first = np.clip(first, np.arange(1, count), anchors - np.arange(count - 1, 0, -1))
    first = np.maximum.accumulate(first - np.arange(count - 1)) + np.arange(count - 1)
    layer = np.empty(anchors, np.intp)
    layer[order] = np.searchsorted(first, np.arange(anchors), side="right")
    return layer
