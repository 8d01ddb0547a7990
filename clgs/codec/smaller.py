"""A smaller scene without training: fewer anchors, coarser integers, and layers of a file.

An anchor shows the opacity times the area of its Gaussians, with no device; the most useful anchors
come first. This order gives better pictures of a small share of the anchors than their own sizes
do, and than what leaving one of them out costs (docs/benchmarks/layers.md).

Features are rounded so that their errors make up for each other in the pictures. They reach
pictures through the networks, where the errors of all channels of an anchor add up. One channel is
rounded after the other, and those that are left take what makes up for the errors so far (Frantar
et al., GPTQ, 2022, do so with weights of networks).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, HEAD_DIMS, K_OFFSETS
from clgs.errors import UsageError
from clgs.options import MAX_LAYERS
from clgs.reference import mlp, neural
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.camera import Camera
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene

Floats = npt.NDArray[np.float64]

DAMPING = 0.01
"""This share of their mean is added to the squares, so that no direction is free."""


def hidden_products(mlps: Mlps) -> Floats:
    """How errors of features (F, F) add up in the hidden layers: a stand-in without views."""
    weights = [mlps.head(head)["hidden_weight"][:, :FEATURE_DIM] for head in HEAD_DIMS]
    stacked = np.concatenate(weights).astype(np.float64)
    return np.asarray(stacked.T @ stacked)


def compensated(values: Floats, products: Floats) -> Floats:
    """Round ``values`` (A, F) so that the sum of e @ products @ e over the errors e stays small.

    Channels that matter most come first. ``products`` (F, F): symmetric, no eigenvalue below 0.
    """
    squares = np.diag(products)
    order = np.argsort(-squares, kind="stable")
    damping = DAMPING * float(squares.mean()) or 1.0
    damped = products[np.ix_(order, order)] + damping * np.eye(len(order))
    shares = np.linalg.cholesky(np.linalg.inv(damped)).T
    left, rounded = np.ascontiguousarray(values[:, order].T), np.empty(values.shape)
    for channel, share in enumerate(shares):
        whole = np.rint(left[channel])
        error = (left[channel] - whole) / share[channel]
        left[channel + 1 :] -= share[channel + 1 :, None] * error
        rounded[:, order[channel]] = whole
    return rounded


POSITION_BITS = 12.0
"""Bits of the position of an anchor, about; taken to be the same for all."""

ENOUGH = 0.99
"""Share of a target size that ends the search."""

MAX_TRIALS = 12

HALVINGS = 7
"""Steps of the search for how coarse Q must be."""

SPAN_LIMIT = 1 << 16
"""Channels with a smaller span of values are counted without sorting."""

Factors = dict[str, float]
"""What Q of "offset", "feature" or "scaling" is multiplied by; at most 1."""


def take(scene: QuantizedScene, rows: npt.NDArray[np.intp]) -> QuantizedScene:
    """The scene with only the anchors ``rows``, in their old order."""
    kept = np.sort(rows)
    return replace(scene, anchors=scene.anchors.map(lambda array: array[kept]))


def coarsen(
    scene: QuantizedScene, factors: Factors, products: npt.NDArray[np.float64] | None = None
) -> QuantizedScene:
    """The scene with fewer integers per unit: integers v become rint(v * factor), as Q does.

    ``products`` (F, F): how errors of features add up; these then make up for each other.
    """
    integers = {}
    for name, factor in factors.items():
        values = getattr(scene.anchors, name) * factor
        if name == "feature" and products is not None:
            values = compensated(values, products)
        integers[name] = np.rint(values).astype(np.int32)
    scales = {name: getattr(scene.scales, name) * factor for name, factor in factors.items()}
    return replace(
        scene, anchors=replace(scene.anchors, **integers), scales=replace(scene.scales, **scales)
    )


def anchor_bits(anchors: QuantizedAnchors) -> npt.NDArray[np.float64]:
    """Bits that each anchor costs, about, (A,): rare values of a channel cost more."""
    bits = np.full(len(anchors), POSITION_BITS)
    if not len(anchors):
        return bits
    for values in (anchors.offset, anchors.feature, anchors.scaling):
        for channel in np.ascontiguousarray(values.reshape(len(anchors), -1).T):
            index = channel.astype(np.intp) - int(channel.min())
            if int(index.max()) >= SPAN_LIMIT:
                _, index = np.unique(channel, return_inverse=True)
            count = np.bincount(index)
            bits += np.log2(len(anchors) / np.maximum(count, 1))[index]
    return bits


def fit_size(
    scene: QuantizedScene,
    order: npt.NDArray[np.intp],
    target: int,
    encode: Callable[[QuantizedScene], bytes],
) -> tuple[QuantizedScene, bytes]:
    """The scene of as many anchors, taken in ``order`` (A,), as fit ``target`` bytes; and its file.

    False position over the number of anchors, with exact sizes: never above ``target``, and at
    least ENOUGH of it or within an anchor of it, if MAX_TRIALS suffice.

    Raises:
        UsageError: the file is larger even without anchors.
    """
    cost = np.concatenate([[0.0], np.cumsum(anchor_bits(scene.anchors)[order] / 8)])
    data = encode(scene)
    if len(data) <= target:
        return scene, data
    least_size(scene, target, encode)

    def cut(count: int) -> tuple[QuantizedScene, bytes]:
        trial = take(scene, order[:count])
        return trial, encode(trial)

    high, high_size, low = len(order), len(data), 0
    best, data = cut(0)
    for _ in range(MAX_TRIALS):
        if high - low <= 1 or len(data) >= ENOUGH * target:
            break
        aim = (1 + ENOUGH) / 2 * target
        share = (aim - len(data)) / (high_size - len(data))
        wanted = cost[low] + share * (cost[high] - cost[low])
        count = int(np.clip(np.searchsorted(cost, wanted), low + 1, high - 1))
        trial, trial_data = cut(count)
        if len(trial_data) <= target:
            best, data, low = trial, trial_data, count
        else:
            high, high_size = count, len(trial_data)
    return best, data


def fit_coarsened(
    scene: QuantizedScene,
    factors: Factors,
    products: npt.NDArray[np.float64],
    order: npt.NDArray[np.intp],
    target: int,
    encode: Callable[[QuantizedScene], bytes],
) -> tuple[QuantizedScene, bytes, Factors]:
    """The scene in ``target`` bytes, which the whole file exceeds, its file and what Q is times.

    Q becomes coarser, by powers from 0 to 1 of ``factors``, until all anchors fit. If they never
    do, or leave too much room, anchors are dropped, too, those at the end of ``order`` (A,) first.
    """

    def coarser(power: float) -> tuple[QuantizedScene, Factors]:
        tried = {n: factor**power for n, factor in factors.items() if factor**power < 1}
        return coarsen(scene, tried, products), tried

    fine, coarse, power = 0.0, 1.0, 1.0
    for _ in range(HALVINGS):
        trial, tried = coarser(power)
        data = encode(trial)
        if ENOUGH * target <= len(data) <= target:
            return trial, data, tried
        fine, coarse = (power, coarse) if len(data) > target else (fine, power)
        if fine == coarse:
            break
        power = (fine + coarse) / 2
    trial, tried = coarser(fine)
    return *fit_size(trial, order, target, encode), tried


def least_size(
    scene: QuantizedScene, target: int, encode: Callable[[QuantizedScene], bytes]
) -> int:
    """Bytes of the file without anchors; UsageError if more than ``target``."""
    least = len(encode(take(scene, np.arange(0))))
    if least > target:
        raise UsageError(
            f"a file of {target:,} bytes is too small: {least:,} bytes remain without anchors; "
            "ask for more"
        )
    return least


BATCH = 8192
"""Anchors that are decoded at once."""

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
FAR = 3.0
"""Without cameras, eyes look from these directions, this many times as far as most anchors."""

MOST = 0.9
"""Share of the anchors that is most of them."""

MARGIN = 0.15
"""What lies outside of a picture by this share of its size counts as seen."""


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
