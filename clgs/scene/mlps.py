"""The three decoding MLPs: weights in one flat vector, views by name, initialisation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from clgs.constants import HEAD_DIMS, HIDDEN_DIM, INPUT_DIM

LAYERS = ("hidden_weight", "hidden_bias", "output_weight", "output_bias")


def head_shapes(head: str) -> dict[str, tuple[int, ...]]:
    """Shapes of one head's four arrays, in packing order; weights are (outputs, inputs)."""
    outputs = HEAD_DIMS[head]
    return {
        "hidden_weight": (HIDDEN_DIM, INPUT_DIM),
        "hidden_bias": (HIDDEN_DIM,),
        "output_weight": (outputs, HIDDEN_DIM),
        "output_bias": (outputs,),
    }


@cache
def head_size(head: str) -> int:
    """Number of weights of one head."""
    return sum(int(np.prod(shape)) for shape in head_shapes(head).values())


MLP_SIZE = sum(head_size(head) for head in HEAD_DIMS)
"""Weights of all three heads: 13,710."""

MATRICES = tuple(
    (shape[0], shape[1] if len(shape) > 1 else 1)
    for head in HEAD_DIMS
    for shape in head_shapes(head).values()
)
"""(rows, columns) of the twelve arrays in packing order; biases are columns."""


@cache
def head_slice(head: str) -> slice:
    """Where one head lies in the flat vector."""
    heads = list(HEAD_DIMS)
    start = sum(head_size(other) for other in heads[: heads.index(head)])
    return slice(start, start + head_size(head))


@dataclass(frozen=True)
class Mlps:
    """Weights of the opacity, color and covariance MLPs: ``flat`` (13710,) float32.

    Order: for each head of ``HEAD_DIMS``, the four arrays of ``LAYERS``, row-major.
    """

    flat: npt.NDArray[np.float32]

    def head(self, head: str) -> dict[str, npt.NDArray[np.float32]]:
        """Views of one head's arrays by layer name."""
        return unpack_head(self.flat, head)


def unpack_head(flat: npt.NDArray[np.float32], head: str) -> dict[str, npt.NDArray[np.float32]]:
    """Views into ``flat`` (13710,), any float dtype, by layer name."""
    start, views = head_slice(head).start, {}
    for name, shape in head_shapes(head).items():
        size = int(np.prod(shape))
        views[name] = flat[start : start + size].reshape(shape)
        start += size
    return views


def init_mlps(rng: np.random.Generator) -> Mlps:
    """Weights and biases uniform in +-1/sqrt(fan_in), PyTorch's default for Linear."""
    flat = np.empty(MLP_SIZE, np.float32)
    for head in HEAD_DIMS:
        for name, array in unpack_head(flat, head).items():
            fan_in = INPUT_DIM if name.startswith("hidden") else HIDDEN_DIM
            bound = 1.0 / np.sqrt(fan_in)
            array[...] = rng.uniform(-bound, bound, array.shape)
    return Mlps(flat)
