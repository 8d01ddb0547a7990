"""Visible anchors to neural Gaussians on the screen, for pictures without gradients.

The opacities are those of ``mlp``; then its other heads, ``neural`` and ``project`` follow at once
for each block of anchors. The results have the same bits as theirs. On a CPU the values in between
stay in its cache; a GPU computes the heads before. Nothing is kept for a backward pass.
"""

from __future__ import annotations

import numpy as np

from clgs.constants import K_OFFSETS
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.ops import mlp, neural, project, scan
from clgs.options import DEFAULT, RenderOptions


def forward(
    device: Device,
    inputs: mlp.Inputs,
    visible: DeviceArray,
    options: RenderOptions = DEFAULT,
    room: int = scan.EXACT,
    screen: project.Screen = project.USUAL_SCREEN,
) -> tuple[project.Projected, DeviceArray]:
    """What ``project.forward`` makes of what ``neural.forward`` makes of ``mlp.forward``.

    Args:
        device: where the arrays live.
        inputs: of the MLPs; here all four tensors of the anchors are read.
        visible: (V,) int32, anchor of each sample, each at most once; -1 at the end: no anchor.
        options: accuracy, and the skips ``opacity_first`` and ``slots``.
        room: N; EXACT waits for the device to learn it.
        screen: as for ``project.forward``.

    Returns:
        N Gaussians on the screen in the order of ``neural.forward``, and (1,) int64, how many there
        are: with a room N is that, and the rest is zero.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    if device.specialisation == "gpu":
        decoded = mlp.forward(device, inputs, visible, options)
    else:
        decoded = mlp.opacities(device, inputs, visible, options, K_OFFSETS)
    drawn, offsets = neural.number(device, decoded)
    count = scan.room_for(device, offsets, room)
    result = project.allocate(device, device.empty((count, 3)), device.empty((count,)))
    anchors, columns = inputs.anchors, decoded.output.shape[1]
    macros = {**project.defines(device, options), **mlp.defines(device, options)}
    device.run(
        device.kernel("gaussian/project_anchors", "project_anchors_forward", **macros),
        *mlp.blocks(device, columns),
        feature=anchors.feature,
        position=anchors.position,
        visible=decoded.visible,
        count=np.int32(len(visible)),
        weights=inputs.weights,
        camera=inputs.camera,
        screen=np.array(screen, np.float32),
        padded=np.int32(columns),
        offset=anchors.offset,
        scaling=anchors.scaling,
        numbers=offsets.offset,
        bits=drawn,
        capacity=np.int32(count),
        output=decoded.output,
        **vars(result),
    )
    if room != scan.EXACT:
        device.run(
            device.kernel("gaussian/project_anchors", "project_anchors_pad", **macros),
            *by_items(count),
            total=offsets.total,
            capacity=np.int32(count),
            **vars(result),
        )
    return result, offsets.total
