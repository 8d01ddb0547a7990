"""Decode features into neural attributes with three MLPs (opacity, color, covariance).

For a visible anchor with feature f at position P, seen from the camera centre c:
    x = [f, d / |d|],  d = P - c;   h = relu(W1 x + b1);   y = act(W2 h + b2)
for each head, where act is tanh for opacity, sigmoid for color and nothing for covariance.
Backward: dL/dz2 = dL/dy act'(y), dL/dz1 = (W2^T dL/dz2) [h > 0], dL/dx = W1^T dL/dz1, and
dL/dW = dL/dz x^T summed over the samples chunk by chunk in a fixed order, without atomics.

An anchor with an input that is not finite (or beyond 1e15) has the output NaN, so that none of
its Gaussians is drawn, and contributes nothing to any gradient.

Source: Scaffold-GS (Lu et al. 2024), without its optional inputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import FEATURE_DIM, HEAD_DIMS, HIDDEN_DIM, INPUT_DIM, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.scene.mlps import MLP_SIZE
from clgs.shapes import Shapes

HIDDEN_ROWS = len(HEAD_DIMS) * HIDDEN_DIM
CHUNK = 1024
"""Samples of which the weight gradient is summed by one work-item or group; fixes the order."""

SLAB = {"cpu": 8 * CHUNK, "gpu": 64 * CHUNK}
"""Samples whose layer gradients are held at once: in cache on a CPU, enough to fill a GPU."""

GROUP_SIZE = 64
"""Work-items of a group on a GPU."""

TILE = {"cpu": 5, "gpu": 10}
VECTORS = {"cpu": 2, "gpu": 1}
"""Register tile of ``kernels_cl/include/mlp_layout.h``: rows, and vectors of samples."""


@dataclass(frozen=True)
class Activations:
    """What the MLPs computed for V visible anchors, feature-major float32.

    Vp is V padded by :func:`padded_size`; padding is finite. input (F+4, Vp): feature, unit
    viewing direction, and a row of ones, which is 0 where a sample does not count (padding, inputs
    that are not finite). hidden (150, Vp) after the ReLU. output (110, Vp): rows [0, 10) opacity
    in (-1, 1); [10, 40) color in (0, 1), row 10 + 3 j + c; [40, 110) covariance, row 40 + 7 j + i,
    three scale logits, then a quaternion w x y z. visible (V,) int32.
    """

    input: DeviceArray
    hidden: DeviceArray
    output: DeviceArray
    visible: DeviceArray


@dataclass(frozen=True)
class MlpGradients:
    """Gradients of the loss, float32: d_weights (13710,), d_feature (A, F), zero where invisible.

    d_position (A, 3) by the viewing direction alone, per scene unit; None where not wanted.
    """

    d_weights: DeviceArray
    d_feature: DeviceArray
    d_position: DeviceArray | None


def padded_size(count: int) -> int:
    """Columns for ``count`` samples: an odd multiple of 32, so that rows share no cache set."""
    return 32 * (-(-count // 32) | 1) if count else 0


def forward(
    device: Device,
    feature: DeviceArray,
    position: DeviceArray,
    visible: DeviceArray,
    weights: DeviceArray,
    camera: DeviceArray,
) -> Activations:
    """Run the MLPs on the visible anchors.

    Args:
        device: where the arrays live.
        feature: (A, F) float32.
        position: (A, 3) float32, scene units.
        visible: (V,) int32, anchor of each sample, each at most once.
        weights: (13710,) float32, packed as in ``clgs.scene.mlps``.
        camera: (26,) float32 from ``Camera.pack``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes(F=FEATURE_DIM)
    shapes.check("feature", feature, "A F", np.float32)
    shapes.check("position", position, "A 3", np.float32)
    shapes.check("visible", visible, "V", np.int32)
    _check_weights(weights, camera)
    count = len(visible)
    padded = padded_size(count)
    result = Activations(
        input=device.empty((INPUT_DIM + 1, padded)),
        hidden=device.empty((HIDDEN_ROWS, padded)),
        output=device.empty((OUTPUT_DIM, padded)),
        visible=visible,
    )
    defines, grid, group = _blocks(device, padded)
    device.run(
        device.kernel("mlp", "mlp_forward", **defines),
        grid,
        group,
        feature,
        position,
        visible,
        np.int32(count),
        np.int32(padded),
        weights,
        camera,
        result.input,
        result.hidden,
        result.output,
    )
    return result


def backward(
    device: Device,
    activations: Activations,
    position: DeviceArray,
    weights: DeviceArray,
    camera: DeviceArray,
    d_output: DeviceArray,
    want_position: bool = False,
) -> MlpGradients:
    """Gradients by weights and features, and by positions where wanted.

    Args:
        device: where the arrays live.
        activations: what :func:`forward` returned.
        position: (A, 3) float32, as given to :func:`forward`; likewise weights and camera.
        weights: (13710,) float32.
        camera: (26,) float32.
        d_output: (110, Vp) float32, gradient by the activated outputs; zero in the padding.
        want_position: whether to compute ``d_position`` (anchors do not move while training).

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes(V=len(activations.visible))
    shapes.check("position", position, "A 3", np.float32)
    shapes.check("output", activations.output, f"{OUTPUT_DIM} P", np.float32)
    shapes.check("d_output", d_output, f"{OUTPUT_DIM} P", np.float32)
    _check_weights(weights, camera)
    result = MlpGradients(
        d_weights=device.empty((MLP_SIZE,)),
        d_feature=device.zeros((len(position), FEATURE_DIM)),
        d_position=device.zeros((len(position), 3)) if want_position else None,
    )
    padded = shapes.axes["P"]
    chunks = -(-padded // CHUNK)
    partial = device.empty((chunks, MLP_SIZE))
    slab = min(SLAB[device.specialisation], padded)
    delta = device.empty((HIDDEN_ROWS + OUTPUT_DIM, padded_size(slab)))
    for first in range(0, padded, max(slab, 1)):
        size = min(slab, padded - first)
        anchors = (position, activations.visible, weights, camera)
        _layers_backward(device, activations, d_output, anchors, (first, size), delta, result)
        _weights_backward(device, activations, (first, size), delta, partial)
    device.run(
        device.kernel("mlp", "mlp_backward_sum", **_defines(device)),
        (round_up(MLP_SIZE, GROUP_SIZE),),
        (GROUP_SIZE,),
        partial,
        np.int32(chunks),
        result.d_weights,
    )
    return result


def _layers_backward(
    device: Device,
    activations: Activations,
    d_output: DeviceArray,
    anchors: tuple[DeviceArray, DeviceArray, DeviceArray, DeviceArray],
    slab: tuple[int, int],
    delta: DeviceArray,
    result: MlpGradients,
) -> None:
    """Fill ``delta`` for the samples of ``slab`` (first, size) and scatter the input gradients."""
    first, size = slab
    defines, grid, group = _blocks(device, size)
    wanted = result.d_position is not None
    device.run(
        device.kernel("mlp", "mlp_backward", WANT_POSITION=int(wanted), **defines),
        grid,
        group,
        activations.input,
        activations.hidden,
        activations.output,
        d_output,
        np.int32(len(activations.visible)),
        np.int32(activations.output.shape[1]),
        np.int32(first),
        np.int32(delta.shape[1]),
        *anchors,
        delta,
        result.d_feature,
        result.d_position if wanted else result.d_feature,
    )


def _weights_backward(
    device: Device,
    activations: Activations,
    slab: tuple[int, int],
    delta: DeviceArray,
    partial: DeviceArray,
) -> None:
    """Weight gradients of the chunks of ``slab`` (first, size), a row of ``partial`` each."""
    first, size = slab
    width = 1 if device.specialisation == "cpu" else GROUP_SIZE
    tile = TILE[device.specialisation]
    device.run(
        device.kernel("mlp", "mlp_backward_weights", **_defines(device)),
        (delta.shape[0] // tile * width, -(-size // CHUNK)),
        (width, 1),
        activations.input,
        activations.hidden,
        np.int32(activations.output.shape[1]),
        np.int32(first),
        np.int32(delta.shape[1]),
        delta,
        partial,
    )


def _defines(device: Device) -> dict[str, int | float]:
    """Lanes that fill one register of a CPU: ten accumulators of wider vectors would spill."""
    native = int(device.cl_device.native_vector_width_float)
    return {"CHUNK": CHUNK, "VEC": min(device.vec, max(native, 4))}


def _blocks(device: Device, samples: int) -> tuple[dict[str, int | float], tuple[int], tuple[int]]:
    """Build options and launch sizes of a kernel with one work-item a block of samples."""
    defines = _defines(device)
    items = -(-samples // (VECTORS[device.specialisation] * int(defines["VEC"])))
    if device.specialisation == "cpu":
        return defines, (items,), (1,)
    return defines, (round_up(items, GROUP_SIZE),), (GROUP_SIZE,)


def _check_weights(weights: DeviceArray, camera: DeviceArray) -> None:
    shapes = Shapes()
    shapes.check("weights", weights, str(MLP_SIZE), np.float32)
    shapes.check("camera", camera, "26", np.float32)
