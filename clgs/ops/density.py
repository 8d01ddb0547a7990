"""Statistics for growing and pruning anchors.

:func:`accumulate` (Scaffold-GS; Voxel-GS): per anchor the sum of the positive opacities of its
slots and the number of views that it was visible in; per slot the sum of the screen-space gradient
norms in NDC units, |(d_x W/2, d_y H/2)|, and the number of views that it was drawn in.

:func:`add_importance` and :func:`add_curvature`: squares of derivatives of a picture's dot product
with random signs, whose means over signs are squared lengths of derivatives of the picture
(Hutchinson's estimator).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np

from clgs.constants import K_OFFSETS
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.ops.neural import NeuralGaussians
from clgs.shapes import Shaped, Shapes

Array = TypeVar("Array", bound=Shaped)
Other = TypeVar("Other", bound=Shaped)

SHARE = {"cpu": 32, "gpu": 1}
"""Gaussians that a work-item adds up."""


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

    output (at least 10, Vp) float32, Vp >= V, feature-major MLP outputs; rows [0, 10) are
    opacities.
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
    """Add the view ``seen`` to the ``statistics`` of all anchors, in place.

    ``stop``: (1,) int32; unless it holds 0 nothing changes. Default: 0.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes(K=K_OFFSETS)
    shapes.check("opacity_sum", statistics.opacity_sum, "A", np.float32)
    shapes.check("visits", statistics.visits, "A", np.int32)
    shapes.check("gradient_sum", statistics.gradient_sum, "A K", np.float32)
    shapes.check("gradient_count", statistics.gradient_count, "A K", np.int32)
    shapes.check("output", seen.output, "rows Vp", np.float32)
    shapes.check("visible", seen.visible, "V", np.int32)
    shapes.check("slot", seen.slot, "N", np.int32)
    shapes.check("extent", seen.extent, "N 2", np.float32)
    shapes.check("d_mean2d", seen.d_mean2d, "N 2", np.float32)
    if shapes.axes["rows"] < K_OFFSETS or shapes.axes["Vp"] < shapes.axes["V"]:
        shape = seen.output.shape
        raise ValueError(f"output: shape is {shape}, {shapes.axes['V']} anchors are visible")
    visible_count, count, padded = shapes.axes["V"], shapes.axes["N"], shapes.axes["Vp"]
    stop = stop or device.zeros((1,), np.int32)
    device.run(
        device.kernel("anchors/density", "density_visit"),
        *by_items(visible_count),
        output=seen.output,
        visible=seen.visible,
        count=np.int32(visible_count),
        padded=np.int32(padded),
        stop=stop,
        opacity_sum=statistics.opacity_sum,
        visits=statistics.visits,
    )
    share = SHARE[device.specialisation]
    device.run(
        device.kernel("anchors/density", "density_gradient", VEC=device.lanes, SHARE=share),
        *by_items(-(-count // share)),
        visible=seen.visible,
        slot=seen.slot,
        extent=seen.extent,
        d_mean2d=seen.d_mean2d,
        count=np.int32(count),
        half_size=np.array([0.5 * seen.size[0], 0.5 * seen.size[1]], np.float32),
        stop=stop,
        gradient_sum=statistics.gradient_sum,
        gradient_count=statistics.gradient_count,
    )


@dataclass(frozen=True)
class Importance:
    """What pictures depend on of A anchors.

    total (A,) float32: a sum over views; seen (A,) int32: 1 if a view shows the anchor.
    """

    total: DeviceArray
    seen: DeviceArray


def no_importance(device: Device, anchors: int) -> Importance:
    """The importance of anchors that were never seen."""
    return Importance(device.zeros((anchors,)), device.zeros((anchors,), np.int32))


def add_importance(
    device: Device,
    importance: Importance,
    visible: DeviceArray,
    gaussians: NeuralGaussians,
    d_opacity: DeviceArray,
) -> None:
    """Add (sum over its Gaussians of opacity d_opacity)^2 to every visible anchor, in place.

    ``visible`` (V,) int32: anchors, each at most once, -1 for none; ``d_opacity`` (N,) float32: by
    the N ``gaussians``, of which opacity and first are read.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("total", importance.total, "A", np.float32)
    shapes.check("seen", importance.seen, "A", np.int32)
    shapes.check("visible", visible, "V", np.int32)
    shapes.check("opacity", gaussians.opacity, "N", np.float32)
    shapes.check("d_opacity", d_opacity, "N", np.float32)
    if gaussians.first.size != visible.size + 1:
        raise ValueError(f"first: size is {gaussians.first.size}, expected {visible.size + 1}")
    device.run(
        device.kernel("anchors/density", "density_importance", VEC=device.lanes),
        *by_items(visible.size),
        visible=visible,
        first=gaussians.first,
        count=np.int32(visible.size),
        gaussians=np.int32(gaussians.opacity.size),
        opacity=gaussians.opacity,
        d_opacity=d_opacity,
        importance=importance.total,
        seen=importance.seen,
    )


def add_curvature(device: Device, curvature: DeviceArray, derivative: DeviceArray) -> None:
    """Add the square of every element of ``derivative`` to ``curvature``, both float32, in place.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    axes = " ".join(f"axis{i}" for i in range(len(curvature.shape)))
    shapes = Shapes()
    shapes.check("curvature", curvature, axes, np.float32)
    shapes.check("derivative", derivative, axes, np.float32)
    device.run(
        device.kernel("anchors/density", "density_curvature", VEC=device.lanes),
        *by_items(-(-derivative.size // device.lanes)),
        derivative=derivative,
        total=np.uint32(derivative.size),
        curvature=curvature,
    )
