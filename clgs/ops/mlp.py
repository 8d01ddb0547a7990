"""Decode features into neural attributes with three MLPs (opacity, color, covariance).

For a visible anchor with feature f at position P, seen from the camera centre c:
    x = [f, d / |d|],  d = P - c;   h = relu(W1 x + b1);   y = act(W2 h + b2)
for each head; act is tanh for opacity, sigmoid for color and nothing for covariance.
Backward: dL/dz2 = dL/dy act'(y), dL/dz1 = (W2^T dL/dz2) [h > 0], dL/dx = W1^T dL/dz1, and
dL/dW = dL/dz x^T summed over the samples batch by batch in a fixed order, without atomics. Hidden
values are computed again in the backward pass instead of being kept.

A slot whose opacity is not positive is not drawn, and its color and covariance are never read;
``options.skips`` says whether they are computed. Opacities come first; then the samples of each
chunk are sorted by the slots that they draw, so that few slots are drawn in each block of samples.

An anchor with an input that is not finite (or beyond 1e15) has the opacities NaN, so that none of
its Gaussians is drawn, and contributes nothing to any gradient. A sample without anchor (-1 in
``visible``) has the opacities 0.

Source: Scaffold-GS (Lu et al. 2024), without its optional inputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, HEAD_DIMS, HIDDEN_DIM, INPUT_DIM, K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.options import DEFAULT, RenderOptions
from clgs.scene.anchors import DeviceAnchors
from clgs.scene.mlps import MLP_SIZE
from clgs.shapes import Shapes

CHUNK = 512
"""Samples that are sorted together."""

BATCH = 512
"""Samples whose weight gradient is computed together; divides CHUNK."""

PARTS = 64
"""Sums that make up the weight gradient; each holds every PARTS-th batch."""

SLAB = 64
"""Batches that a GPU works on at once, at most PARTS."""

WORKERS = 1
"""Work-items per compute unit of a CPU; each takes parts until none is left."""

GROUP_SIZE = 64
"""Work-items of a group on a GPU that sorts samples or sums weight gradients."""

TILE = 5
VECTORS = 2
"""Register tile of a CPU, ``kernels_cl/mlp/layout.h``: rows, and vectors of samples."""

SAMPLES = 64
LAYER_ITEMS = 128
"""Samples that a group computes on a GPU, and its work-items (``kernels_cl/mlp/group/layer.h``)."""

WEIGHT_ROWS = {"cpu": 4, "gpu": 10}
COLUMNS = {"cpu": 3, "gpu": 7}
"""Register tile of the weight gradient: rows, and inputs."""


@dataclass(frozen=True)
class Inputs:
    """What the MLPs read: the anchors, the weights, and the camera of the view.

    anchors: position and feature are read; weights (13710,) float32, packed as in
    ``clgs.scene.mlps``; camera (26,) float32 from ``Camera.pack``.
    """

    anchors: DeviceAnchors
    weights: DeviceArray
    camera: DeviceArray

    def check(self) -> None:
        """Raise ValueError or TypeError if an array has the wrong shape or dtype."""
        self.anchors.check(np.float32)
        shapes = Shapes()
        shapes.check("weights", self.weights, str(MLP_SIZE), np.float32)
        shapes.check("camera", self.camera, "26", np.float32)


@dataclass(frozen=True)
class Activations:
    """What the MLPs computed for V visible anchors.

    output (110, Vp) float32, feature-major, Vp is V padded by :func:`padded_size`: rows [0, 10)
    opacity in (-1, 1); [10, 40) color in (0, 1), row 10 + 3 j + c; [40, 110) covariance, row
    40 + 7 j + i, three scale logits, then a quaternion w x y z. Color and covariance of a slot that
    is not drawn may be anything. visible (V,) int32: the anchor of each column, those given to
    ``forward`` in another order within each chunk; -1, no anchor, stays at the end.
    active (chunks,) int32: how many samples draw something; they are the first of their chunk.
    """

    output: DeviceArray
    visible: DeviceArray
    active: DeviceArray
    options: RenderOptions


@dataclass(frozen=True)
class MlpGradients:
    """Gradients of the loss, float32: d_weights (13710,), d_feature (A, F), zero if invisible.

    d_position (A, 3) by the viewing direction alone, per scene unit; None if not wanted.
    """

    d_weights: DeviceArray
    d_feature: DeviceArray
    d_position: DeviceArray | None


def padded_size(count: int) -> int:
    """Columns for ``count`` samples: an odd multiple of 32, so that rows share no cache set."""
    return 32 * (-(-count // 32) | 1) if count else 0


def forward(
    device: Device, inputs: Inputs, visible: DeviceArray, options: RenderOptions = DEFAULT
) -> Activations:
    """Run the MLPs on the visible anchors.

    Args:
        device: where the arrays live.
        inputs: anchors, weights and camera.
        visible: (V,) int32, anchor of each sample, each at most once; -1 at the end: no anchor.
        options: the skips ``opacity_first`` and ``slots``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    result = opacities(device, inputs, visible, options)
    anchors, padded = inputs.anchors, result.output.shape[1]
    device.run(
        device.kernel("mlp/forward", "mlp_heads", **defines(device, options)),
        *_layer_sizes(device, padded),
        anchors.feature,
        anchors.position,
        result.visible,
        np.int32(len(visible)),
        inputs.weights,
        inputs.camera,
        np.int32(padded),
        result.output,
    )
    return result


def opacities(
    device: Device,
    inputs: Inputs,
    visible: DeviceArray,
    options: RenderOptions,
    rows: int = OUTPUT_DIM,
) -> Activations:
    """As :func:`forward`, but the outputs, ``rows`` of them, hold nothing but the opacities."""
    inputs.check()
    Shapes().check("visible", visible, "V", np.int32)
    count = len(visible)
    padded = padded_size(count)
    result = Activations(
        output=device.empty((rows, padded)),
        visible=device.empty((count,), np.int32),
        active=device.empty((-(-padded // CHUNK),), np.int32),
        options=options,
    )
    macros, anchors = defines(device, options), inputs.anchors
    size, columns, opacity = np.int32(count), np.int32(padded), device.empty((K_OFFSETS, padded))
    device.run(
        device.kernel("mlp/forward", "mlp_opacity", **macros),
        *_layer_sizes(device, padded),
        anchors.feature,
        anchors.position,
        visible,
        size,
        inputs.weights,
        inputs.camera,
        columns,
        opacity,
    )
    width = GROUP_SIZE if device.specialisation == "gpu" else 1
    device.run(
        device.kernel("mlp/order", "mlp_order", **macros),
        (len(result.active) * width,),
        (width,),
        opacity,
        visible,
        size,
        columns,
        result.output,
        result.visible,
        result.active,
    )
    return result


def backward(
    device: Device,
    inputs: Inputs,
    activations: Activations,
    d_output: DeviceArray,
    want_position: bool = False,
) -> MlpGradients:
    """Gradients by weights and features, and by positions if wanted.

    Args:
        device: where the arrays live.
        inputs: as given to :func:`forward`.
        activations: what :func:`forward` returned.
        d_output: (110, Vp) float32, gradient by the activated outputs; that of a slot that is not
            drawn counts as zero.
        want_position: whether to compute ``d_position`` (anchors do not move while training).

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    inputs.check()
    anchors, shapes = inputs.anchors, Shapes()
    shapes.check("output", activations.output, f"{OUTPUT_DIM} P", np.float32)
    shapes.check("d_output", d_output, f"{OUTPUT_DIM} P", np.float32)
    result = MlpGradients(
        d_weights=device.empty((MLP_SIZE,)),
        d_feature=device.zeros(anchors.feature.shape),
        d_position=device.zeros(anchors.position.shape) if want_position else None,
    )
    parts = min(-(-activations.output.shape[1] // BATCH), PARTS)
    partial = device.zeros((parts, _part_size(device)))
    read = _backward_arguments(inputs, activations, d_output)
    unused = result.d_feature
    outputs = (result.d_feature, unused if result.d_position is None else result.d_position)
    common = defines(device, activations.options)
    macros = {**common, "WANT_POSITION": int(want_position)}
    if device.specialisation == "cpu":
        workers = min(WORKERS * int(device.cl_device.max_compute_units), parts)
        values, taken = device.empty((workers, _batch_size(device))), device.zeros((1,), np.int32)
        kernel = device.kernel("mlp/backward", "mlp_backward", **macros)
        device.run(kernel, (workers,), (1,), *read, taken, values, partial, *outputs)
    else:
        _backward_in_groups(device, activations, read, outputs, partial, macros)
    device.run(
        device.kernel("mlp/backward_sum", "mlp_backward_sum", **common),
        *_sum_sizes(device),
        *(partial, np.int32(parts), result.d_weights),
    )
    return result


def _backward_arguments(
    inputs: Inputs, activations: Activations, d_output: DeviceArray
) -> tuple[DeviceArray | np.int32, ...]:
    """What ``mlp_backward`` and ``mlp_backward_layers`` read, in the order of their arguments."""
    return (
        inputs.anchors.feature,
        inputs.anchors.position,
        activations.visible,
        np.int32(len(activations.visible)),
        inputs.weights,
        inputs.camera,
        np.int32(activations.output.shape[1]),
        activations.output,
        d_output,
        activations.active,
    )


def _batch_size(device: Device) -> int:
    """Floats of the rows of one batch: on a GPU of all heads, on a CPU of one at a time."""
    if device.specialisation == "gpu":
        rows = len(HEAD_DIMS) * 2 * HIDDEN_DIM + OUTPUT_DIM
    else:
        rows = FEATURE_DIM + TILE + 2 * HIDDEN_DIM + max(HEAD_DIMS.values())
    return (INPUT_DIM + 1 + rows) * (BATCH + 16)


def _row_tiles(device: Device) -> int:
    """Register tiles of rows in both layers of all heads."""
    rows = WEIGHT_ROWS[device.specialisation]
    return sum(-(-HIDDEN_DIM // rows) + -(-outputs // rows) for outputs in HEAD_DIMS.values())


def _column_tiles(device: Device) -> int:
    """The most register tiles beside each other."""
    return -(-(INPUT_DIM + 1) // COLUMNS[device.specialisation])


def _part_size(device: Device) -> int:
    """Floats of a part of the weight gradient: weights and padding."""
    form = device.specialisation
    return _row_tiles(device) * _column_tiles(device) * WEIGHT_ROWS[form] * COLUMNS[form]


def _sum_sizes(device: Device) -> tuple[tuple[int], tuple[int]]:
    """Launch sizes of the sum of the parts: a work-item per sum, on a CPU per register tile."""
    if device.specialisation == "gpu":
        return (round_up(_part_size(device), GROUP_SIZE),), (GROUP_SIZE,)
    return (_row_tiles(device) * _column_tiles(device),), (1,)


def _backward_in_groups(
    device: Device,
    activations: Activations,
    read: tuple[DeviceArray | np.int32, ...],
    outputs: tuple[DeviceArray, DeviceArray],
    partial: DeviceArray,
    macros: dict[str, int | float],
) -> None:
    """Fill ``partial`` and ``outputs``, SLAB batches at a time."""
    padded = activations.output.shape[1]
    batches = -(-padded // BATCH)
    values = device.empty((min(SLAB, batches), _batch_size(device)))
    layers = device.kernel("mlp/backward", "mlp_backward_layers", **macros)
    weights = device.kernel("mlp/backward", "mlp_backward_weights", **macros)
    for first in range(0, batches, SLAB):
        size, place = min(SLAB, batches - first), (np.int32(first), values)
        device.run(layers, *_layer_sizes(device, size * BATCH), *read, *place, *outputs)
        device.run(
            weights,
            (_row_tiles(device) * GROUP_SIZE, size),
            (GROUP_SIZE, 1),
            *(np.int32(padded), activations.active, *place, partial),
        )


def drawn_rows(output: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Which outputs (110, V) are ever read: all opacities, and the rows of drawn slots."""
    drawn = output[:K_OFFSETS] > 0
    color, covariance = (HEAD_DIMS[name] // K_OFFSETS for name in ("color", "covariance"))
    rows = [np.ones_like(drawn), np.repeat(drawn, color, 0), np.repeat(drawn, covariance, 0)]
    return np.concatenate(rows)


def drawn_output(device: Device, activations: Activations) -> npt.NDArray[np.float32]:
    """Host copy (110, V) of the outputs, zero for those that are never read."""
    output = device.download(activations.output)[:, : len(activations.visible)]
    return np.where(drawn_rows(output), output, np.float32(0))


@dataclass(frozen=True)
class Work:
    """Samples, and rows of outputs times samples, that were computed, and how many there are."""

    samples: int
    all_samples: int
    rows: int
    all_rows: int


def work(device: Device, activations: Activations) -> Work:
    """Count the samples whose colors and covariances were computed, and the rows of these heads.

    Waits for the device. Columns without an anchor are not counted.
    """
    count = int(np.count_nonzero(device.download(activations.visible) >= 0))
    drawn = device.download(activations.output)[:K_OFFSETS] > 0
    vector = int(defines(device, activations.options)["VEC"])
    size = SAMPLES if device.specialisation == "gpu" else VECTORS * vector
    drawn = np.pad(drawn, ((0, 0), (0, -drawn.shape[1] % size)))
    slots = np.any(drawn.reshape(K_OFFSETS, -1, size), axis=2)
    used = np.any(slots, axis=0)
    skips = activations.options.skips
    if not skips.slots:
        slots[:] = used | (not skips.opacity_first)
    if not skips.opacity_first:
        used[:] = True
    lanes = np.clip(count - size * np.arange(len(used)), 0, size)
    each = (OUTPUT_DIM - K_OFFSETS) // K_OFFSETS
    return Work(
        samples=int(used @ lanes),
        all_samples=count,
        rows=each * int((slots @ lanes).sum()),
        all_rows=each * K_OFFSETS * count,
    )


def defines(device: Device, options: RenderOptions) -> dict[str, int | float]:
    """Build options of the kernels.

    Lanes fill one register of a CPU: ten accumulators of wider vectors would spill.
    """
    sizes = {"CHUNK": CHUNK, "BATCH": BATCH, "PARTS": PARTS, "VEC": device.register_lanes}
    return {**sizes, **options.skips.defines("opacity_first", "slots")}


def blocks(device: Device, samples: int) -> tuple[tuple[int], tuple[int]]:
    """Launch sizes of a kernel with one work-item per block of samples."""
    if device.specialisation == "gpu":
        return (round_up(samples, GROUP_SIZE),), (GROUP_SIZE,)
    lanes = int(defines(device, DEFAULT)["VEC"])
    return (-(-samples // (VECTORS * lanes)),), (1,)


def _layer_sizes(device: Device, samples: int) -> tuple[tuple[int], tuple[int]]:
    """Launch sizes of a kernel that computes layers: on a GPU a group per SAMPLES samples."""
    if device.specialisation == "gpu":
        return (-(-samples // SAMPLES) * LAYER_ITEMS,), (LAYER_ITEMS,)
    return blocks(device, samples)
