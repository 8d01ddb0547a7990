"""Statistics for growing and pruning anchors (Scaffold-GS; Voxel-GS).

Per anchor the sum of the positive opacities of its slots and the number of views that it was
visible in; per slot the sum of the screen-space gradient norms in NDC units,
|(d_x W/2, d_y H/2)|, and the number of views that it was drawn in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.shapes import Shaped, Shapes

Array = TypeVar("Array", bound=Shaped)
Other = TypeVar("Other", bound=Shaped)

GROUP_SIZE = 64

SHARE = {"cpu": 32, "gpu": 1}
"""Gaussians of a work-item."""


@dataclass(frozen=True)
class Statistics(Generic[Array]):
    """What training saw of A anchors since a sum was last zeroed, on the host or on a device.

    opacity_sum (A,) float32 of the positive opacities; visits (A,) int32 steps in which the anchor
    was visible; gradient_sum (A, K) float32 norms of the screen gradient in NDC units;
    gradient_count (A, K) int32 steps in which the slot was drawn.
    """

    opacity_sum: Array
    visits: Array
    gradient_sum: Array
    gradient_count: Array

    def items(self) -> Iterator[tuple[str, Array]]:
        """(name, array) of all."""
        return ((field.name, getattr(self, field.name)) for field in fields(self))

    def map(self, change: Callable[[Array], Other]) -> Statistics[Other]:
        """The statistics whose arrays ``change`` makes, for example ``device.upload``."""
        return Statistics(*(change(array) for _, array in self.items()))


DeviceStatistics = Statistics[DeviceArray]


@dataclass(frozen=True)
class SeenView:
    """What one view of ``size`` (width, height) pixels showed: V anchors and N Gaussians.

    output (110, Vp) float32, Vp >= V, feature-major MLP outputs; rows [0, 10) are opacities.
    visible (V,) int32, anchor of every column, each at most once; -1 is none.
    slot (N,) int32 = index in visible * K + offset, each at most once, or -1 if the extent is 0;
    extent (N, 2) float32, drawn if positive; d_mean2d (N, 2) float32 per pixel.
    """

    output: DeviceArray
    visible: DeviceArray
    slot: DeviceArray
    extent: DeviceArray
    d_mean2d: DeviceArray
    size: tuple[int, int]


def zeros(device: Device, anchors: int) -> DeviceStatistics:
    """Statistics of anchors that were never seen."""
    return Statistics(
        opacity_sum=device.zeros((anchors,)),
        visits=device.zeros((anchors,), np.int32),
        gradient_sum=device.zeros((anchors, K_OFFSETS)),
        gradient_count=device.zeros((anchors, K_OFFSETS), np.int32),
    )


def accumulate(
    device: Device,
    statistics: DeviceStatistics,
    seen: SeenView,
    stop: DeviceArray | None = None,
) -> None:
    """Add one view to ``statistics`` in place.

    Args:
        device: where the arrays live.
        statistics: of all anchors.
        seen: the view.
        stop: (1,) int32; unless it holds 0 nothing changes. Default: 0.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    visible_count, count, padded = _check(statistics, seen)
    stop = stop or device.zeros((1,), np.int32)
    device.run(
        device.kernel("anchors/density", "density_visit"),
        (round_up(visible_count, GROUP_SIZE),),
        (GROUP_SIZE,),
        seen.output,
        seen.visible,
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
        seen.visible,
        seen.slot,
        seen.extent,
        seen.d_mean2d,
        np.int32(count),
        np.array([0.5 * seen.size[0], 0.5 * seen.size[1]], np.float32),
        stop,
        statistics.gradient_sum,
        statistics.gradient_count,
    )


def _check(statistics: DeviceStatistics, seen: SeenView) -> tuple[int, int, int]:
    """(V, N, Vp)."""
    shapes = Shapes(K=K_OFFSETS)
    shapes.check("opacity_sum", statistics.opacity_sum, "A", np.float32)
    shapes.check("visits", statistics.visits, "A", np.int32)
    shapes.check("gradient_sum", statistics.gradient_sum, "A K", np.float32)
    shapes.check("gradient_count", statistics.gradient_count, "A K", np.int32)
    shapes.check("output", seen.output, f"{OUTPUT_DIM} Vp", np.float32)
    shapes.check("visible", seen.visible, "V", np.int32)
    shapes.check("slot", seen.slot, "N", np.int32)
    shapes.check("extent", seen.extent, "N 2", np.float32)
    shapes.check("d_mean2d", seen.d_mean2d, "N 2", np.float32)
    if shapes.axes["Vp"] < shapes.axes["V"]:
        raise ValueError(f"output: {shapes.axes['Vp']} columns, {shapes.axes['V']} are visible")
    return shapes.axes["V"], shapes.axes["N"], shapes.axes["Vp"]
