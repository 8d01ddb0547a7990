"""Visible anchors to neural Gaussians, for pictures without gradients.

The opacities are those of ``mlp``; then its other heads and ``neural`` follow at once for each
block of anchors. The results are theirs, bit by bit, but on a CPU the outputs of the heads stay in
its cache, and nothing is left that a backward pass would need.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import mlp, neural, scan
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes


@dataclass(frozen=True)
class Anchors:
    """What is decoded, float32: position (A, 3), offset (A, K, 3), feature (A, F), scaling (A, 6).

    Units are those of ``mlp.forward`` and ``neural.forward``.
    """

    position: DeviceArray
    offset: DeviceArray
    feature: DeviceArray
    scaling: DeviceArray


def forward(
    device: Device,
    anchors: Anchors,
    visible: DeviceArray,
    weights: DeviceArray,
    camera: DeviceArray,
    options: RenderOptions = DEFAULT,
    capacity: int | None = None,
) -> neural.NeuralGaussians:
    """What ``neural.forward`` makes of the outputs of ``mlp.forward``.

    Args:
        device: where the arrays live.
        anchors: of the whole scene.
        visible: (V,) int32, anchor of each sample, each at most once; -1 at the end: no anchor.
        weights: (13710,) float32, packed as in ``clgs.scene.mlps``.
        camera: (26,) float32 from ``Camera.pack``.
        options: the skips ``opacity_first`` and ``slots``.
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
    result = neural.allocate(device, count, drawn, offsets)
    device.run(
        device.kernel("decode", "decode_forward", **mlp.defines(device, options)),
        *mlp.blocks(device, int(sizes[1])),
        *(*inputs, decoded.visible, sizes[0], weights, camera, sizes[1]),
        *(anchors.offset, anchors.scaling, offsets.offset, drawn, np.int32(count)),
        *(decoded.output, *neural.fields(result)),
    )
    if capacity is not None:
        neural.pad(device, result)
    return result
