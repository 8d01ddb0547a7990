"""The three decoding MLPs in float64, forward and backward, head by head."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import HEAD_DIMS, HIDDEN_DIM, INPUT_DIM
from clgs.reference.project import Array

INPUT_LIMIT = 1e15
"""A larger input counts as not finite."""

CENTRE = slice(23, 26)
"""The camera centre in a packed camera."""


@dataclass(frozen=True)
class Activations:
    """What ``clgs.ops.mlp.Activations`` holds, without padding, and the layers before it."""

    input: Array
    hidden: Array
    output: Array
    visible: npt.NDArray[np.int32]


@dataclass(frozen=True)
class HeadWeights:
    """One head's weights (views), and its rows of the outputs."""

    name: str
    hidden_weight: Array
    hidden_bias: Array
    output_weight: Array
    output_bias: Array
    units: slice
    rows: slice


def heads(weights: Array) -> Iterator[HeadWeights]:
    """Views into the packed weights (13710,); layout as in ``clgs.scene.mlps``."""
    start, row = 0, 0
    for number, (name, outputs) in enumerate(HEAD_DIMS.items()):
        shapes = [(HIDDEN_DIM, INPUT_DIM), (HIDDEN_DIM,), (outputs, HIDDEN_DIM), (outputs,)]
        arrays = []
        for shape in shapes:
            size = int(np.prod(shape))
            arrays.append(weights[start : start + size].reshape(shape))
            start += size
        units = slice(number * HIDDEN_DIM, (number + 1) * HIDDEN_DIM)
        rows = slice(row, row + outputs)
        yield HeadWeights(name, arrays[0], arrays[1], arrays[2], arrays[3], units, rows)
        row += outputs


def view_direction(position: Array, centre: Array) -> tuple[Array, Array]:
    """Unit vectors (V, 3) from the camera centre to the positions, and distances (V, 1).

    At the centre itself the direction is zero.
    """
    step = position - centre
    with np.errstate(invalid="ignore"):
        distance = np.linalg.norm(step, axis=1, keepdims=True)
        return np.divide(step, distance, out=np.zeros_like(step), where=distance != 0), distance


def activate(name: str, z: Array) -> Array:
    """Output activation of a head."""
    if name == "opacity":
        return np.tanh(z)
    if name == "color":
        return 1 / (1 + np.exp(-z))
    return z


def activation_slope(name: str, y: Array) -> Array:
    """Derivative of :func:`activate`, from its value."""
    if name == "opacity":
        return 1 - y * y
    if name == "color":
        return y * (1 - y)
    return np.ones_like(y)


def forward(
    feature: Array,
    position: Array,
    visible: npt.NDArray[np.int32],
    weights: Array,
    camera: npt.NDArray[np.floating],
) -> Activations:
    """Run the MLPs; shapes as in ``clgs.ops.mlp.forward``, samples in the order of visible."""
    direction, _ = view_direction(position[visible], np.asarray(camera[CENTRE], np.float64))
    x = np.concatenate([feature[visible], direction, np.ones((len(visible), 1))], axis=1).T
    with np.errstate(invalid="ignore"):
        good = np.all(np.abs(x) <= INPUT_LIMIT, axis=0) & (visible >= 0)
    x = np.where(good, x, 0)
    bad = np.where(visible < 0, 0, np.nan)
    hidden, output = [], []
    for head in heads(weights):
        z = head.hidden_weight @ x[:INPUT_DIM] + head.hidden_bias[:, None]
        hidden.append(np.maximum(z, 0))
        z = head.output_weight @ hidden[-1] + head.output_bias[:, None]
        output.append(np.where(good, activate(head.name, z), bad))
    return Activations(x, np.concatenate(hidden), np.concatenate(output), visible)


def backward(
    activations: Activations, anchors: int, weights: Array, d_output: Array
) -> tuple[Array, Array]:
    """d_weights (13710,) and d_feature (A, F); as ``clgs.ops.mlp.backward``.

    ``anchors``: A. But for samples that do not count, every ``d_output`` counts, whether its slot
    is drawn or not.
    """
    x, visible = activations.input, activations.visible
    good = x[INPUT_DIM] == 1
    d_weights, d_x = np.zeros_like(weights), np.zeros((INPUT_DIM, len(visible)))
    for head, slot in zip(heads(weights), heads(d_weights), strict=True):
        hidden, y = activations.hidden[head.units], activations.output[head.rows]
        d_z2 = np.where(good, d_output[head.rows] * activation_slope(head.name, y), 0)
        d_z1 = np.where(hidden > 0, head.output_weight.T @ d_z2, 0)
        slot.output_weight[...] = d_z2 @ hidden.T
        slot.output_bias[...] = d_z2.sum(axis=1)
        slot.hidden_weight[...] = d_z1 @ x[:INPUT_DIM].T
        slot.hidden_bias[...] = d_z1.sum(axis=1)
        d_x += head.hidden_weight.T @ d_z1
    d_feature = np.zeros((anchors, INPUT_DIM - 3))
    seen = visible >= 0
    d_feature[visible[seen]] = d_x[:-3, seen].T
    return d_weights, d_feature
