"""Statistics for growing and pruning anchors (Scaffold-GS; Voxel-GS).

Per anchor the sum of the positive opacities of its slots and the number of views that it was
visible in; per slot the sum of the screen-space gradient norms in NDC units,
|(d_x W/2, d_y H/2)|, and the number of views that it was drawn in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.shapes import Shapes

GROUP_SIZE = 64

SHARE = {"cpu": 32, "gpu": 1}
"""Gaussians of a work-item."""


@dataclass(frozen=True)
class Statistics:
    """Running sums of A anchors.

    opacity_sum (A,) float32 and visits (A,) int32; gradient_sum (A, K) float32 in NDC units and
    gradient_count (A, K) int32.
    """

    opacity_sum: DeviceArray
    visits: DeviceArray
    gradient_sum: DeviceArray
    gradient_count: DeviceArray


@dataclass(frozen=True)
class ScreenGradients:
    """The N Gaussians of one view.

    slot (N,) int32 = index in visible * K + offset, or -1 where the extent is 0; extent (N, 2)
    float32, drawn where positive;
    d_mean2d (N, 2) float32 per pixel; width and height of the image in pixels.
    """

    slot: DeviceArray
    extent: DeviceArray
    d_mean2d: DeviceArray
    width: int
    height: int


def zeros(device: Device, anchors: int) -> Statistics:
    """Statistics of anchors that were never seen."""
    return Statistics(
        opacity_sum=device.zeros((anchors,)),
        visits=device.zeros((anchors,), np.int32),
        gradient_sum=device.zeros((anchors, K_OFFSETS)),
        gradient_count=device.zeros((anchors, K_OFFSETS), np.int32),
    )


def accumulate(
    device: Device,
    statistics: Statistics,
    output: DeviceArray,
    visible: DeviceArray,
    gradients: ScreenGradients,
    stop: DeviceArray | None = None,
) -> None:
    """Add one view to ``statistics`` in place.

    Args:
        device: where the arrays live.
        statistics: of all anchors.
        output: (110, Vp) float32, Vp >= V, feature-major MLP outputs; rows [0, 10) are opacities.
        visible: (V,) int32, anchor of every column, each at most once; -1 is none.
        gradients: of the view's Gaussians, each slot at most once.
        stop: (1,) int32; unless it holds 0 nothing changes. Default: 0.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    visible_count, count, padded = _check(statistics, output, visible, gradients)
    stop = stop or device.zeros((1,), np.int32)
    device.run(
        device.kernel("anchors/density", "density_visit"),
        (round_up(visible_count, GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        visible,
        np.int32(visible_count),
        np.int32(padded),
        stop,
        statistics.opacity_sum,
        statistics.visits,
    )
    share = SHARE[device.specialisation]
    device.run(
        device.kernel("anchors/density", "density_gradient", VEC=device.lanes, SHARE=share),
        (round_up(-(-count // share), GROUP_SIZE),),
        (GROUP_SIZE,),
        visible,
        gradients.slot,
        gradients.extent,
        gradients.d_mean2d,
        np.int32(count),
        np.array([0.5 * gradients.width, 0.5 * gradients.height], np.float32),
        stop,
        statistics.gradient_sum,
        statistics.gradient_count,
    )


def _check(
    statistics: Statistics, output: DeviceArray, visible: DeviceArray, gradients: ScreenGradients
) -> tuple[int, int, int]:
    """(V, N, Vp)."""
    shapes = Shapes(K=K_OFFSETS)
    shapes.check("opacity_sum", statistics.opacity_sum, "A", np.float32)
    shapes.check("visits", statistics.visits, "A", np.int32)
    shapes.check("gradient_sum", statistics.gradient_sum, "A K", np.float32)
    shapes.check("gradient_count", statistics.gradient_count, "A K", np.int32)
    shapes.check("output", output, f"{OUTPUT_DIM} Vp", np.float32)
    shapes.check("visible", visible, "V", np.int32)
    shapes.check("slot", gradients.slot, "N", np.int32)
    shapes.check("extent", gradients.extent, "N 2", np.float32)
    shapes.check("d_mean2d", gradients.d_mean2d, "N 2", np.float32)
    if shapes.axes["Vp"] < shapes.axes["V"]:
        raise ValueError(f"output: {shapes.axes['Vp']} columns, {shapes.axes['V']} are visible")
    return shapes.axes["V"], shapes.axes["N"], shapes.axes["Vp"]
