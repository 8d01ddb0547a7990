"""A scene cut to a file size without training: fewer anchors, and coarser integers.

Features are rounded so that their errors make up for each other in the pictures. They reach
pictures through the networks, where the errors of all channels of an anchor add up. One channel is
rounded after the other, and those that are left take what makes up for the errors so far (Frantar
et al., GPTQ, 2022, do so with weights of networks).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, HEAD_DIMS
from clgs.errors import UsageError
from clgs.scene.anchors import QuantizedAnchors
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
