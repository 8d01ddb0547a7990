"""Statistics for growing and pruning, anchor by anchor and slot by slot, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]


@dataclass
class Statistics:
    """The fields of ``clgs.ops.density.Statistics``: (A,), (A,), (A, K), (A, K)."""

    opacity_sum: Array
    visits: Integers
    gradient_sum: Array
    gradient_count: Integers


def zeros(anchors: int) -> Statistics:
    """Statistics of anchors that were never seen."""
    shape = (anchors, K_OFFSETS)
    return Statistics(
        np.zeros(anchors), np.zeros(anchors, np.int32), np.zeros(shape), np.zeros(shape, np.int32)
    )


def accumulate(
    statistics: Statistics,
    output: Array,
    visible: Integers,
    gaussians: tuple[Integers, Array, Array],
    size: tuple[int, int],
) -> None:
    """Add one view: MLP outputs (110, Vp), visible (V,), (slot, extent, d_mean2d), (W, H)."""
    for column, anchor in enumerate(visible):
        opacities = output[:K_OFFSETS, column]
        statistics.opacity_sum[anchor] += opacities[opacities > 0].sum()
        statistics.visits[anchor] += 1
    for slot, extent, d_mean2d in zip(*gaussians, strict=True):
        if not extent[0] > 0:
            continue
        column, offset = divmod(slot, K_OFFSETS)
        width, height = size
        norm = np.hypot(d_mean2d[0] * width / 2, d_mean2d[1] * height / 2)
        statistics.gradient_sum[visible[column], offset] += norm
        statistics.gradient_count[visible[column], offset] += 1


def importance(
    visible: Integers, slot: Integers, opacity: Array, d_opacity: Array, anchors: int
) -> Array:
    """(A,) squares of the sums of opacity times derivative over the Gaussians of each anchor."""
    sums = np.zeros(anchors)
    for number, product in zip(slot, opacity * d_opacity, strict=True):
        if number >= 0:
            sums[visible[number // K_OFFSETS]] += product
    return np.square(sums)
