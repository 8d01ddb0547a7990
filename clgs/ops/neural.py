"""Neural Gaussians from the MLPs' outputs: one for each slot with a positive opacity.

For slot j of a visible anchor with position P, offset O_j and log scales S (clamped to
+-LOG_SCALE_LIMIT, with gradient zero outside):
    mean = P + O_j exp(S[0:3]),   scale = exp(S[3:6]) sigmoid(logits),   rotation = q / |q|.
Opacity and color are the MLPs' outputs as they are. A NaN opacity is not positive; a quaternion
without direction (zero, not finite) gives the rotation 0, which projection culls, and gradient 0.

Source: Scaffold-GS (Lu et al. 2024); Voxel-GS sections 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items, by_lanes
from clgs.ops import scan
from clgs.ops.mlp import Activations
from clgs.scene.anchors import DeviceAnchors
from clgs.shapes import Shapes


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians in space, float32.

    mean (N, 3) scene units; scale (N, 3) scene units; rotation (N, 4) unit quaternion w x y z;
    color (N, 3) RGB in [0, 1]; opacity (N,) in (0, 1].
    """

    mean: DeviceArray
    scale: DeviceArray
    rotation: DeviceArray
    color: DeviceArray
    opacity: DeviceArray


@dataclass(frozen=True)
class NeuralGaussians(Gaussians):
    """Gaussians in ascending order of slot, and where they come from.

    slot (N,) int32 = v * K + j for slot j of the v-th visible anchor; first (V + 1,) int32, number
    of the first Gaussian of each visible anchor; drawn (V,) int32, bit j for its slot j; total (1,)
    int64, how many Gaussians there are.

    With a room N is that, and what follows the first ``total`` is padding: zeros, slot -1. If
    ``total`` is larger than N, the last Gaussians are left out.
    """

    slot: DeviceArray
    first: DeviceArray
    drawn: DeviceArray
    total: DeviceArray

    def __len__(self) -> int:
        return len(self.slot)


@dataclass(frozen=True)
class GaussianGradients:
    """Gradients of the loss by the fields of N neural Gaussians, float32, of the same shapes."""

    d_mean: DeviceArray
    d_scale: DeviceArray
    d_rotation: DeviceArray
    d_color: DeviceArray
    d_opacity: DeviceArray


@dataclass(frozen=True)
class NeuralGradients:
    """Gradients of the loss, float32, dense: zero if nothing was drawn.

    d_output (110, Vp) by the MLPs' outputs, anything for a slot that is not drawn;
    d_offset (A, K, 3); d_scaling (A, 6).
    """

    d_output: DeviceArray
    d_offset: DeviceArray
    d_scaling: DeviceArray


def forward(
    device: Device,
    activations: Activations,
    anchors: DeviceAnchors,
    room: int = scan.EXACT,
) -> NeuralGaussians:
    """Gather the Gaussians of the visible anchors.

    ``activations`` are from ``mlp.forward``, and ``anchors`` those of the whole scene; ``room``: N,
    and EXACT waits for the device to learn it.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(activations, anchors)
    output, visible = activations.output, activations.visible
    drawn, offsets = number(device, activations)
    count = scan.room_for(device, offsets, room)
    rows = {
        "mean": device.empty((count, 3)),
        "scale": device.empty((count, 3)),
        "rotation": device.empty((count, 4)),
        "color": device.empty((count, 3)),
        "opacity": device.empty((count,)),
        "slot": device.empty((count,), np.int32),
    }
    device.run(
        device.kernel("gaussian/neural", "neural_forward"),
        *by_lanes(device, len(visible), device.vec),
        output=output,
        visible=visible,
        first=offsets.offset,
        bits=drawn,
        count=np.int32(len(visible)),
        padded=np.int32(output.shape[1]),
        capacity=np.int32(count),
        position=anchors.position,
        offset=anchors.offset,
        scaling=anchors.scaling,
        **rows,
    )
    if room != scan.EXACT:
        device.run(
            device.kernel("gaussian/neural", "neural_pad"),
            *by_items(count),
            total=offsets.total,
            capacity=np.int32(count),
            **rows,
        )
    return NeuralGaussians(**rows, first=offsets.offset, drawn=drawn, total=offsets.total)


def number(device: Device, activations: Activations) -> tuple[DeviceArray, scan.Offsets]:
    """Which slots of each visible anchor are drawn, and the number of its first Gaussian.

    Only the opacities are read, the first K rows of the output.
    """
    count = len(activations.visible)
    drawn, counts = device.empty((count,), np.int32), device.empty((count,), np.int32)
    parts = scan.parts_of(device, count, device.vec)
    device.run(
        device.kernel("gaussian/neural_count", "neural_count"),
        *scan.counting_grid(device, count, device.vec, group=1),
        output=activations.output,
        visible=activations.visible,
        count=np.int32(count),
        padded=np.int32(activations.output.shape[1]),
        drawn=drawn,
        counts=counts,
        sums=parts.sum,
    )
    return drawn, scan.on_device(device, counts, parts=parts)


def backward(
    device: Device,
    gaussians: NeuralGaussians,
    activations: Activations,
    anchors: DeviceAnchors,
    d_gaussians: GaussianGradients,
) -> NeuralGradients:
    """Scatter the gradients of N Gaussians to the anchors and the MLPs' outputs.

    ``gaussians`` is what :func:`forward` made of ``activations``, which has each anchor at most
    once, and ``anchors``; ``d_gaussians`` has the gradients by its fields. There is
    none by positions: anchors do not move while training.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(activations, anchors)
    output, visible = activations.output, activations.visible
    shapes, widths = Shapes(N=len(gaussians)), {"d_rotation": "N 4", "d_opacity": "N"}
    for name, array in vars(d_gaussians).items():
        shapes.check(name, array, widths.get(name, "N 3"), np.float32)
    result = NeuralGradients(
        d_output=device.empty(output.shape),
        d_offset=device.zeros(anchors.offset.shape),
        d_scaling=device.zeros(anchors.scaling.shape),
    )
    device.run(
        device.kernel("gaussian/neural", "neural_backward"),
        *by_lanes(device, output.shape[1], device.vec),
        output=output,
        visible=visible,
        first=gaussians.first,
        bits=gaussians.drawn,
        count=np.int32(len(visible)),
        padded=np.int32(output.shape[1]),
        capacity=np.int32(len(gaussians)),
        offset=anchors.offset,
        scaling=anchors.scaling,
        **vars(d_gaussians),
        **vars(result),
    )
    return result


def _check(activations: Activations, anchors: DeviceAnchors) -> None:
    """Raise ValueError or TypeError if an array has the wrong shape or dtype."""
    anchors.check(np.float32)
    shapes = Shapes()
    shapes.check("output", activations.output, f"{OUTPUT_DIM} P", np.float32)
    shapes.check("visible", activations.visible, "V", np.int32)
    if shapes.axes["V"] > shapes.axes["P"]:
        raise ValueError(f"output: {shapes.axes['P']} columns for {shapes.axes['V']} anchors")
