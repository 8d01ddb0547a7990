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

from clgs.constants import FEATURE_DIM, HEAD_DIMS, HIDDEN_DIM, INPUT_DIM, K_OFFSETS, OUTPUT_DIM
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import LaunchSizes, by_items
from clgs.opencl.kernel import Argument
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

TILE = {"cpu": 5, "gpu": 10}
VECTORS = {"cpu": 2, "gpu": 1}
"""Register tile of a layer: rows, and vectors of samples."""

SAMPLES = 64
LAYER_ITEMS = 128
SLICE = 8
"""Samples that a group computes on a GPU, its work-items, and inputs whose weights it holds."""

HEADS_PER_GROUP = len(HEAD_DIMS)
"""Heads whose backward pass a group computes on a GPU, one after the other."""

WEIGHT_ROWS = {"cpu": 4, "gpu": 10}
COLUMNS = {"cpu": 3, "gpu": 7}
"""Register tile of the weight gradient: rows, and inputs."""


FEW_REGISTERS = {"SAMPLES": 32, "SLICE": 4, "HEADS_PER_GROUP": 1, "COLUMNS": 3}
"""What is smaller on Intel's GPUs. With more sums per work-item their compiler runs 8 work-items at
a time instead of 16, or keeps sums in memory (docs/benchmarks/devices.md)."""


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
    """Gradients of the loss, float32: d_weights (13710,), d_feature (A, F), zero if invisible."""

    d_weights: DeviceArray
    d_feature: DeviceArray


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
    device.run(
        device.kernel("mlp/forward", "mlp_heads", **defines(device, options)),
        *_layer_sizes(device, result.output.shape[1]),
        **_layer_arguments(inputs, result.visible, result.output),
        output=result.output,
    )
    return result


def opacities(
    device: Device,
    inputs: Inputs,
    visible: DeviceArray,
    options: RenderOptions,
    rows: int = OUTPUT_DIM,
) -> Activations:
    """Do the part of :func:`forward` that gives opacities; the other ``rows`` hold nothing."""
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
    macros, opacity = defines(device, options), device.empty((K_OFFSETS, padded))
    device.run(
        device.kernel("mlp/forward", "mlp_opacity", **macros),
        *_layer_sizes(device, padded),
        **_layer_arguments(inputs, visible, opacity),
        opacity=opacity,
    )
    width = GROUP_SIZE if device.specialisation == "gpu" else 1
    device.run(
        device.kernel("mlp/order", "mlp_order", **macros),
        (len(result.active) * width,),
        (width,),
        opacity=opacity,
        visible=visible,
        count=np.int32(count),
        padded=np.int32(padded),
        output=result.output,
        sorted=result.visible,
        active=result.active,
    )
    return result


def _layer_arguments(
    inputs: Inputs, visible: DeviceArray, output: DeviceArray
) -> dict[str, Argument]:
    """What the kernels that compute layers read; ``output``: has the columns of the samples."""
    return {
        "feature": inputs.anchors.feature,
        "position": inputs.anchors.position,
        "visible": visible,
        "count": np.int32(len(visible)),
        "weights": inputs.weights,
        "camera": inputs.camera,
        "padded": np.int32(output.shape[1]),
    }


def backward(
    device: Device,
    inputs: Inputs,
    activations: Activations,
    d_output: DeviceArray,
    by_weights: bool = True,
) -> MlpGradients:
    """Gradients by weights and features; anchors do not move while training.

    Args:
        device: where the arrays live.
        inputs: as given to :func:`forward`.
        activations: what :func:`forward` returned.
        d_output: (110, Vp) float32, gradient by the activated outputs; that of a slot that is not
            drawn counts as zero.
        by_weights: whether the gradient by the weights is wanted; if not, it is left out, as 0.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    inputs.check()
    anchors, shapes = inputs.anchors, Shapes()
    shapes.check("output", activations.output, f"{OUTPUT_DIM} P", np.float32)
    shapes.check("d_output", d_output, f"{OUTPUT_DIM} P", np.float32)
    result = MlpGradients(
        d_weights=device.empty((MLP_SIZE,)) if by_weights else device.zeros((MLP_SIZE,)),
        d_feature=device.zeros(anchors.feature.shape),
    )
    parts = min(-(-activations.output.shape[1] // BATCH), PARTS)
    partial = device.zeros((parts, _part_size(device) if by_weights else 1))
    layers: dict[str, Argument] = {
        **_layer_arguments(inputs, activations.visible, activations.output),
        "output": activations.output,
        "d_output": d_output,
        "active": activations.active,
    }
    written: dict[str, Argument] = {"d_feature": result.d_feature}
    macros = defines(device, activations.options)
    if device.specialisation == "cpu":
        macros["BY_WEIGHTS"] = int(by_weights)
        workers = min(WORKERS * int(device.cl_device.max_compute_units), parts)
        device.run(
            device.kernel("mlp/backward", "mlp_backward", **macros),
            *((workers,), (1,)),
            **layers,
            **written,
            next=device.zeros((1,), np.int32),
            values=device.empty((workers, _batch_size(device))),
            partial=partial,
        )
    else:
        sums = partial if by_weights else None
        _backward_in_groups(device, activations.output.shape[1], layers, written, sums, macros)
    if not by_weights:
        return result
    form = device.specialisation  # a work-item per sum, on a CPU per register tile
    each = 1 if form == "gpu" else WEIGHT_ROWS[form] * COLUMNS[form]
    device.run(
        device.kernel("mlp/backward_sum", "mlp_backward_sum", **macros),
        *by_items(_part_size(device) // each, GROUP_SIZE if form == "gpu" else 1),
        partial=partial,
        parts=np.int32(parts),
        d_weights=result.d_weights,
    )
    return result


def _batch_size(device: Device) -> int:
    """Floats of the rows of one batch: on a GPU of all heads, on a CPU of one at a time."""
    if device.specialisation == "gpu":
        rows = len(HEAD_DIMS) * 2 * HIDDEN_DIM + OUTPUT_DIM
    else:
        rows = FEATURE_DIM + 2 * HIDDEN_DIM + max(HEAD_DIMS.values())
    return (INPUT_DIM + 1 + rows) * (BATCH + 16)


def _row_tiles(device: Device) -> int:
    """Register tiles of rows in both layers of all heads."""
    rows = sizes(device)["WEIGHT_ROWS"]
    return sum(-(-HIDDEN_DIM // rows) + -(-outputs // rows) for outputs in HEAD_DIMS.values())


def _part_size(device: Device) -> int:
    """Floats of a part of the weight gradient: weights and padding."""
    rows, columns = sizes(device)["WEIGHT_ROWS"], sizes(device)["COLUMNS"]
    inputs = max(INPUT_DIM, HIDDEN_DIM)  # of a layer
    return _row_tiles(device) * rows * -(-(inputs + 1) // columns) * columns


def _backward_in_groups(
    device: Device,
    padded: int,
    layers: dict[str, Argument],
    written: dict[str, Argument],
    partial: DeviceArray | None,
    macros: dict[str, int | float],
) -> None:
    """Fill ``written`` and, if it is there, ``partial``, SLAB batches at a time."""
    batches = -(-padded // BATCH)
    values = device.empty((min(SLAB, batches), _batch_size(device)))
    not_read = "feature", "position", "camera", "output", "d_output"
    inputs = {name: value for name, value in layers.items() if name not in not_read}
    for first in range(0, batches, SLAB):
        size = min(SLAB, batches - first)
        items, group = _layer_sizes(device, size * BATCH)
        batch: dict[str, Argument] = {"first_batch": np.int32(first), "values": values}
        device.run(
            device.kernel("mlp/backward", "mlp_backward_layers", **macros),
            (*items, len(HEAD_DIMS) // sizes(device)["HEADS_PER_GROUP"]),
            (LAYER_ITEMS, 1),
            **layers,
            **batch,
        )
        device.run(
            device.kernel("mlp/backward", "mlp_backward_inputs", **macros),
            items,
            group,
            **inputs,
            **batch,
            **written,
        )
        if partial is None:
            continue
        device.run(
            device.kernel("mlp/backward", "mlp_backward_weights", **macros),
            (_row_tiles(device) * GROUP_SIZE, size),
            (GROUP_SIZE, 1),
            padded=layers["padded"],
            active=layers["active"],
            **batch,
            partial=partial,
        )


def defines(device: Device, options: RenderOptions) -> dict[str, int | float]:
    """Build options of the kernels.

    Lanes fill one register of a CPU: ten accumulators of wider vectors would spill.
    """
    return {
        "CHUNK": CHUNK,
        "BATCH": BATCH,
        "PARTS": PARTS,
        "GROUP_SIZE": GROUP_SIZE,
        **sizes(device),
        "VEC": device.register_lanes,
        **options.skips.defines("opacity_first", "slots"),
    }


def sizes(device: Device) -> dict[str, int]:
    """What a work-item and a group compute, by the names of the build options; no bit depends."""
    form = device.specialisation
    usual = {
        "TILE": TILE[form],
        "VECTORS": VECTORS[form],
        "SAMPLES": SAMPLES,
        "LAYER_ITEMS": LAYER_ITEMS,
        "SLICE": SLICE,
        "HEADS_PER_GROUP": HEADS_PER_GROUP,
        "WEIGHT_ROWS": WEIGHT_ROWS[form],
        "COLUMNS": COLUMNS[form],
    }
    return usual | FEW_REGISTERS if device.has_few_registers else usual


def blocks(device: Device, samples: int) -> LaunchSizes:
    """Launch sizes of a kernel with one work-item per block of samples."""
    if device.specialisation == "gpu":
        return by_items(samples, GROUP_SIZE)
    return by_items(-(-samples // (VECTORS["cpu"] * device.register_lanes)), 1)


def _layer_sizes(device: Device, samples: int) -> LaunchSizes:
    """Launch sizes of a kernel that computes layers: on a GPU whole groups."""
    if device.specialisation == "gpu":
        return (-(-samples // sizes(device)["SAMPLES"]) * LAYER_ITEMS,), (LAYER_ITEMS,)
    return blocks(device, samples)
