"""What kernels decide: from builds of the blending that say so, and from outputs of the MLPs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.constants import HEAD_DIMS, K_OFFSETS, TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, mlp
from clgs.reference.blend import Decisions


def blend_decisions(
    device: Device, blended: blend.Blended, d_image: DeviceArray
) -> tuple[Decisions, Decisions]:
    """What the forward and what the backward kernel decide; slow."""
    words = (len(blended.tiles.gaussian), TILE_SIZE**2 // 32)
    found = []
    for kernel, arguments in blend.observed_passes(device, blended, d_image, EXPORT_DECISIONS=1):
        bits = {name: device.zeros(words, np.uint32) for name in ("blended", "clamped")}
        device.run(kernel, *blend.tile_grid(device, blended.tiles), **arguments, **bits)
        words_of = (device.download(one)[:, :, None] for one in bits.values())
        taken = (one >> np.arange(32, dtype=np.uint32) & np.uint32(1) for one in words_of)
        found.append(Decisions(*(one.reshape(-1, TILE_SIZE**2).astype(bool) for one in taken)))
    return found[0], found[1]


def drawn_rows(output: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Which outputs (110, V) of the MLPs are ever read: opacities, and the rows of drawn slots."""
    drawn = output[:K_OFFSETS] > 0
    color, covariance = (HEAD_DIMS[name] // K_OFFSETS for name in ("color", "covariance"))
    rows = [np.ones_like(drawn), np.repeat(drawn, color, 0), np.repeat(drawn, covariance, 0)]
    return np.concatenate(rows)


def drawn_output(device: Device, activations: mlp.Activations) -> npt.NDArray[np.float32]:
    """Host copy (110, V) of the MLPs' outputs, zero for those that are never read."""
    output = device.download(activations.output)[:, : len(activations.visible)]
    return np.where(drawn_rows(output), output, np.float32(0))
