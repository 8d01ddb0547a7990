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

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.ops import scan
from clgs.shapes import Shapes

GROUP_SIZE = 64


@dataclass(frozen=True)
class NeuralGaussians:
    """N Gaussians in ascending order of slot, float32 unless said otherwise.

    mean (N, 3) scene units; scale (N, 3) scene units; rotation (N, 4) unit quaternion w x y z;
    color (N, 3) RGB in [0, 1]; opacity (N,) in (0, 1]; slot (N,) int32 = v * K + j for slot j of
    the v-th visible anchor; first (V + 1,) int32, number of the first Gaussian of each visible
    anchor; drawn (V,) int32, bit j for its slot j; total (1,) int64, how many Gaussians there are.

    With a capacity N is that, and what lies behind ``total`` is padding: zeros, slot -1. Where
    ``total`` is larger than N, the Gaussians behind are left out.
    """

    mean: DeviceArray
    scale: DeviceArray
    rotation: DeviceArray
    color: DeviceArray
    opacity: DeviceArray
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
    """Gradients of the loss, float32, dense: zero where nothing was drawn.

    d_output (110, Vp) by the MLPs' outputs, where a slot is not drawn it may be anything;
    d_offset (A, K, 3); d_scaling (A, 6); d_position (A, 3), None where not wanted.
    """

    d_output: DeviceArray
    d_offset: DeviceArray
    d_scaling: DeviceArray
    d_position: DeviceArray | None


def forward(
    device: Device,
    output: DeviceArray,
    visible: DeviceArray,
    position: DeviceArray,
    offset: DeviceArray,
    scaling: DeviceArray,
    capacity: int | None = None,
) -> NeuralGaussians:
    """Gather the Gaussians of the visible anchors.

    Args:
        device: where the arrays live.
        output: (110, Vp) float32, feature-major outputs of ``mlp.forward``.
        visible: (V,) int32, V <= Vp; -1 is no anchor.
        position: (A, 3) float32, scene units.
        offset: (A, K, 3) float32, in units of exp(scaling[:, :3]).
        scaling: (A, 6) float32, log of scene units.
        capacity: how many Gaussians to make room for; default: wait for the device to count them.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    Shapes(A=_check(output, visible, offset, scaling)).check("position", position, "A 3", "f4")
    sizes = np.int32(len(visible)), np.int32(output.shape[1])
    drawn, offsets = number(device, output, visible, sizes)
    count = scan.checked_total(device, offsets) if capacity is None else capacity
    result = allocate(device, count, drawn, offsets)
    device.run(
        device.kernel("gaussian/neural", "neural_forward"),
        (round_up(-(-len(visible) // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        visible,
        offsets.offset,
        drawn,
        *sizes,
        np.int32(count),
        position,
        offset,
        scaling,
        *fields(result),
    )
    if capacity is not None:
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
    """What there is of every Gaussian, in the order of the kernels' arguments."""
    return (
        gaussians.mean,
        gaussians.scale,
        gaussians.rotation,
        gaussians.color,
        gaussians.opacity,
        gaussians.slot,
    )


def number(
    device: Device, output: DeviceArray, visible: DeviceArray, sizes: tuple[np.int32, np.int32]
) -> tuple[DeviceArray, scan.Offsets]:
    """Which slots of each visible anchor are drawn, and the number of its first Gaussian.

    output: its first K rows are the opacities; sizes: V and the columns of output.
    """
    drawn = device.empty((int(sizes[0]),), np.int32)
    counts = device.empty((int(sizes[0]),), np.int32)
    device.run(
        device.kernel("gaussian/neural", "neural_count"),
        (round_up(-(-len(counts) // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        visible,
        *sizes,
        drawn,
        counts,
    )
    return drawn, scan.on_device(device, counts)


def pad(device: Device, gaussians: NeuralGaussians) -> None:
    """Zeros behind the last Gaussian."""
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
    output: DeviceArray,
    visible: DeviceArray,
    offset: DeviceArray,
    scaling: DeviceArray,
    d_gaussians: GaussianGradients,
    want_position: bool = False,
) -> NeuralGradients:
    """Scatter the gradients of N Gaussians to the anchors and the MLPs' outputs.

    Args:
        device: where the arrays live.
        gaussians: what :func:`forward` returned for output, visible, offset and scaling.
        output: (110, Vp) float32.
        visible: (V,) int32, each anchor at most once; -1 is no anchor.
        offset: (A, K, 3) float32.
        scaling: (A, 6) float32.
        d_gaussians: gradients by the fields of ``gaussians``.
        want_position: whether to compute ``d_position`` (anchors do not move while training).

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    anchors = _check(output, visible, offset, scaling)
    _check_gradients(d_gaussians, len(gaussians))
    result = NeuralGradients(
        d_output=device.empty(output.shape),
        d_offset=device.zeros(offset.shape),
        d_scaling=device.zeros(scaling.shape),
        d_position=device.zeros((anchors, 3)) if want_position else None,
    )
    device.run(
        device.kernel("gaussian/neural", "neural_backward"),
        (round_up(-(-output.shape[1] // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        visible,
        gaussians.first,
        gaussians.drawn,
        np.int32(len(visible)),
        np.int32(output.shape[1]),
        np.int32(len(gaussians)),
        offset,
        scaling,
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


def _check(
    output: DeviceArray, visible: DeviceArray, offset: DeviceArray, scaling: DeviceArray
) -> int:
    """Number of anchors.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes(K=K_OFFSETS)
    shapes.check("output", output, f"{OUTPUT_DIM} P", np.float32)
    shapes.check("visible", visible, "V", np.int32)
    shapes.check("offset", offset, "A K 3", np.float32)
    shapes.check("scaling", scaling, "A 6", np.float32)
    if shapes.axes["V"] > shapes.axes["P"]:
        raise ValueError(f"output: {shapes.axes['P']} columns for {shapes.axes['V']} anchors")
    return shapes.axes["A"]


def _check_gradients(d_gaussians: GaussianGradients, count: int) -> None:
    shapes = Shapes(N=count)
    shapes.check("d_mean", d_gaussians.d_mean, "N 3", np.float32)
    shapes.check("d_scale", d_gaussians.d_scale, "N 3", np.float32)
    shapes.check("d_rotation", d_gaussians.d_rotation, "N 4", np.float32)
    shapes.check("d_color", d_gaussians.d_color, "N 3", np.float32)
    shapes.check("d_opacity", d_gaussians.d_opacity, "N", np.float32)
