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
from clgs.opencl.device import Device, round_up
from clgs.opencl.grid import by_lanes
from clgs.ops import scan
from clgs.ops.mlp import Activations
from clgs.scene.anchors import DeviceAnchors
from clgs.shapes import Shapes

GROUP_SIZE = 64


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
    d_offset (A, K, 3); d_scaling (A, 6); d_position (A, 3), None if not wanted.
    """

    d_output: DeviceArray
    d_offset: DeviceArray
    d_scaling: DeviceArray
    d_position: DeviceArray | None


def forward(
    device: Device,
    activations: Activations,
    anchors: DeviceAnchors,
    room: int = scan.EXACT,
) -> NeuralGaussians:
    """Gather the Gaussians of the visible anchors.

    Args:
        device: where the arrays live.
        activations: from ``mlp.forward``; output and visible are read.
        anchors: of the whole scene; all but the feature is read.
        room: N; EXACT waits for the device to learn it.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(activations, anchors)
    output, visible = activations.output, activations.visible
    drawn, offsets = number(device, activations)
    count = scan.room_for(device, offsets, room)
    result = allocate(device, count, drawn, offsets)
    device.run(
        device.kernel("gaussian/neural", "neural_forward"),
        *by_lanes(device, len(visible), device.vec),
        output,
        visible,
        offsets.offset,
        drawn,
        np.int32(len(visible)),
        np.int32(output.shape[1]),
        np.int32(count),
        anchors.position,
        anchors.offset,
        anchors.scaling,
        *fields(result),
    )
    if room != scan.EXACT:
        pad(device, result)
    return result


def allocate(
    device: Device, count: int, drawn: DeviceArray, offsets: scan.Offsets
) -> NeuralGaussians:
    """Room for ``count`` Gaussians, numbered as :func:`number` returned."""
    return NeuralGaussians(
        mean=device.empty((count, 3)),
        scale=device.empty((count, 3)),
        rotation=device.empty((count, 4)),
        color=device.empty((count, 3)),
        opacity=device.empty((count,)),
        slot=device.empty((count,), np.int32),
        first=offsets.offset,
        drawn=drawn,
        total=offsets.total,
    )


def fields(gaussians: NeuralGaussians) -> tuple[DeviceArray, ...]:
    """The arrays with a row per Gaussian, in the order of the kernels' arguments."""
    return (
        gaussians.mean,
        gaussians.scale,
        gaussians.rotation,
        gaussians.color,
        gaussians.opacity,
        gaussians.slot,
    )


def number(device: Device, activations: Activations) -> tuple[DeviceArray, scan.Offsets]:
    """Which slots of each visible anchor are drawn, and the number of its first Gaussian.

    Only the opacities are read, the first K rows of the output.
    """
    count = len(activations.visible)
    drawn, counts = device.empty((count,), np.int32), device.empty((count,), np.int32)
    parts = scan.parts_of(device, count, device.vec)
    device.run(
        device.kernel("gaussian/neural", "neural_count"),
        *scan.counting_grid(device, count, device.vec, group=1),
        activations.output,
        activations.visible,
        np.int32(count),
        np.int32(activations.output.shape[1]),
        drawn,
        counts,
        parts.sum,
    )
    return drawn, scan.on_device(device, counts, parts=parts)


def pad(device: Device, gaussians: NeuralGaussians) -> None:
    """Zeros after the last Gaussian."""
    device.run(
        device.kernel("gaussian/neural", "neural_pad"),
        (round_up(len(gaussians), GROUP_SIZE),),
        (GROUP_SIZE,),
        gaussians.total,
        np.int32(len(gaussians)),
        *fields(gaussians),
    )


def backward(
    device: Device,
    gaussians: NeuralGaussians,
    activations: Activations,
    anchors: DeviceAnchors,
    d_gaussians: GaussianGradients,
    want_position: bool = False,
) -> NeuralGradients:
    """Scatter the gradients of N Gaussians to the anchors and the MLPs' outputs.

    Args:
        device: where the arrays live.
        gaussians: what :func:`forward` returned.
        activations: as given to :func:`forward`, each anchor at most once.
        anchors: as given to :func:`forward`.
        d_gaussians: gradients by the fields of ``gaussians``.
        want_position: whether to compute ``d_position`` (anchors do not move while training).

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(activations, anchors)
    output, visible = activations.output, activations.visible
    _check_gradients(d_gaussians, len(gaussians))
    result = NeuralGradients(
        d_output=device.empty(output.shape),
        d_offset=device.zeros(anchors.offset.shape),
        d_scaling=device.zeros(anchors.scaling.shape),
        d_position=device.zeros(anchors.position.shape) if want_position else None,
    )
    device.run(
        device.kernel("gaussian/neural", "neural_backward"),
        *by_lanes(device, output.shape[1], device.vec),
        output,
        visible,
        gaussians.first,
        gaussians.drawn,
        np.int32(len(visible)),
        np.int32(output.shape[1]),
        np.int32(len(gaussians)),
        anchors.offset,
        anchors.scaling,
        d_gaussians.d_mean,
        d_gaussians.d_scale,
        d_gaussians.d_rotation,
        d_gaussians.d_color,
        d_gaussians.d_opacity,
        result.d_output,
        result.d_offset,
        result.d_scaling,
    )
    if result.d_position is not None:
        _position_backward(device, gaussians, visible, d_gaussians.d_mean, result.d_position)
    return result


def _position_backward(
    device: Device,
    gaussians: NeuralGaussians,
    visible: DeviceArray,
    d_mean: DeviceArray,
    d_position: DeviceArray,
) -> None:
    """Sum ``d_mean`` over the Gaussians of each visible anchor."""
    device.run(
        device.kernel("gaussian/neural", "neural_backward_position"),
        (round_up(len(visible), GROUP_SIZE),),
        (GROUP_SIZE,),
        visible,
        gaussians.first,
        np.int32(len(visible)),
        np.int32(len(gaussians)),
        d_mean,
        d_position,
    )


def _check(activations: Activations, anchors: DeviceAnchors) -> None:
    """Raise ValueError or TypeError if an array has the wrong shape or dtype."""
    anchors.check(np.float32)
    shapes = Shapes()
    shapes.check("output", activations.output, f"{OUTPUT_DIM} P", np.float32)
    shapes.check("visible", activations.visible, "V", np.int32)
    if shapes.axes["V"] > shapes.axes["P"]:
        raise ValueError(f"output: {shapes.axes['P']} columns for {shapes.axes['V']} anchors")


def _check_gradients(d_gaussians: GaussianGradients, count: int) -> None:
    shapes = Shapes(N=count)
    shapes.check("d_mean", d_gaussians.d_mean, "N 3", np.float32)
    shapes.check("d_scale", d_gaussians.d_scale, "N 3", np.float32)
    shapes.check("d_rotation", d_gaussians.d_rotation, "N 4", np.float32)
    shapes.check("d_color", d_gaussians.d_color, "N 3", np.float32)
    shapes.check("d_opacity", d_gaussians.d_opacity, "N", np.float32)
