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
    the v-th visible anchor; first (V,) int32, number of the first Gaussian of each, with N after
    the last in its buffer.
    """

    mean: DeviceArray
    scale: DeviceArray
    rotation: DeviceArray
    color: DeviceArray
    opacity: DeviceArray
    slot: DeviceArray
    first: DeviceArray

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

    d_output (110, Vp) by the MLPs' outputs; d_offset (A, K, 3); d_scaling (A, 6);
    d_position (A, 3), None where not wanted.
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
) -> NeuralGaussians:
    """Gather the Gaussians of the visible anchors.

    Args:
        device: where the arrays live.
        output: (110, Vp) float32, feature-major outputs of ``mlp.forward``.
        visible: (V,) int32, V <= Vp.
        position: (A, 3) float32, scene units.
        offset: (A, K, 3) float32, in units of exp(scaling[:, :3]).
        scaling: (A, 6) float32, log of scene units.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    Shapes(A=_check(output, visible, offset, scaling)).check("position", position, "A 3", "f4")
    sizes = np.int32(len(visible)), np.int32(output.shape[1])
    first, total = _number(device, output, sizes)
    result = NeuralGaussians(
        mean=device.empty((total, 3)),
        scale=device.empty((total, 3)),
        rotation=device.empty((total, 4)),
        color=device.empty((total, 3)),
        opacity=device.empty((total,)),
        slot=device.empty((total,), np.int32),
        first=first,
    )
    device.run(
        device.kernel("neural", "neural_forward"),
        (round_up(-(-len(visible) // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        visible,
        first,
        *sizes,
        position,
        offset,
        scaling,
        result.mean,
        result.scale,
        result.rotation,
        result.color,
        result.opacity,
        result.slot,
    )
    return result


def _number(
    device: Device, output: DeviceArray, sizes: tuple[np.int32, np.int32]
) -> tuple[DeviceArray, int]:
    """Number (V,) int32 of each visible anchor's first Gaussian, and how many there are."""
    counts = device.empty((int(sizes[0]),), np.int32)
    device.run(
        device.kernel("neural", "neural_count"),
        (round_up(len(counts), GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        *sizes,
        counts,
    )
    return scan.exclusive(device, counts)


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
        visible: (V,) int32, each anchor at most once.
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
        device.kernel("neural", "neural_backward"),
        (round_up(-(-output.shape[1] // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        output,
        visible,
        gaussians.first,
        np.int32(len(visible)),
        np.int32(output.shape[1]),
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
        device.kernel("neural", "neural_backward_position"),
        (round_up(len(visible), GROUP_SIZE),),
        (GROUP_SIZE,),
        visible,
        gaussians.first,
        np.int32(len(visible)),
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
