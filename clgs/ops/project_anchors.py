"""Visible anchors to neural Gaussians on the screen, for pictures without gradients.

The opacities are those of ``mlp``; then its other heads, ``neural`` and ``project`` follow at once
for each block of anchors. The results are theirs, bit by bit, but on a CPU what only they read
stays in its cache, and nothing is left that a backward pass would need.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.ops import mlp, neural, project, scan
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes

GROUP_SIZE = 64


@dataclass(frozen=True)
class Anchors:
    """What is decoded, float32: position (A, 3), offset (A, K, 3), feature (A, F), scaling (A, 6).

    Units are those of ``mlp.forward`` and ``neural.forward``.
    """

    position: DeviceArray
    offset: DeviceArray
    feature: DeviceArray
    scaling: DeviceArray


@dataclass(frozen=True)
class Splats:
    """N Gaussians as they are drawn, in the order of ``neural.forward``.

    projected; color (N, 3) float32; opacity (N,) float32; total (1,) int64, how many there are:
    with a capacity N is that, and what lies behind is zero.
    """

    projected: project.Projected
    color: DeviceArray
    opacity: DeviceArray
    total: DeviceArray


def forward(
    device: Device,
    anchors: Anchors,
    visible: DeviceArray,
    weights: DeviceArray,
    camera: DeviceArray,
    options: RenderOptions = DEFAULT,
    capacity: int | None = None,
) -> Splats:
    """What ``project.forward`` makes of what ``neural.forward`` makes of ``mlp.forward``.

    Args:
        device: where the arrays live.
        anchors: of the whole scene.
        visible: (V,) int32, anchor of each sample, each at most once; -1 at the end: no anchor.
        weights: (13710,) float32, packed as in ``clgs.scene.mlps``.
        camera: (26,) float32 from ``Camera.pack``.
        options: accuracy, and the skips ``opacity_first`` and ``slots``.
        capacity: how many Gaussians to make room for; default: wait for the device to count them.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes(A=len(anchors.position), K=K_OFFSETS)
    shapes.check("offset", anchors.offset, "A K 3", np.float32)
    shapes.check("scaling", anchors.scaling, "A 6", np.float32)
    inputs = anchors.feature, anchors.position
    rows = OUTPUT_DIM if device.specialisation == "gpu" else K_OFFSETS
    decoded = mlp.opacities(device, *inputs, visible, weights, camera, options, rows)
    sizes = np.int32(len(visible)), np.int32(decoded.output.shape[1])
    drawn, offsets = neural.number(device, decoded.output, decoded.visible, sizes)
    count = scan.checked_total(device, offsets) if capacity is None else capacity
    colors = device.empty((count, 3)), device.empty((count,))
    result = Splats(project.allocate(device, count), *colors, offsets.total)
    on_screen = result.projected
    fields = (on_screen.mean2d, on_screen.whitening, on_screen.depth, on_screen.extent, *colors)
    macros = {**project.defines(device, options), **mlp.defines(device, options)}
    device.run(
        device.kernel("gaussian/project_anchors", "project_anchors_forward", **macros),
        *mlp.blocks(device, int(sizes[1])),
        *(*inputs, decoded.visible, sizes[0], weights, camera, sizes[1]),
        *(anchors.offset, anchors.scaling, offsets.offset, drawn, np.int32(count)),
        *(decoded.output, *fields),
    )
    if capacity is not None:
        device.run(
            device.kernel("gaussian/project_anchors", "project_anchors_pad", **macros),
            *((round_up(count, GROUP_SIZE),), (GROUP_SIZE,)),
            *(offsets.total, np.int32(count), *fields),
        )
    return result
