"""The weights of the MLPs to bytes and back: as integers if they are multiples, else as floats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.scene.mlps import MATRICES

MODES = ("auto", "float32")
"""auto: integers if that is shorter; float32: the bytes of the floats in any case."""

Matrices = Sequence[tuple[int, int]]


def encode(
    weights: npt.NDArray[np.float32], mode: str = "auto", matrices: Matrices = MATRICES
) -> bytes:
    """The stream of ``weights`` (n,) float32, bit for bit.

    Weights are coded as integers if those of every matrix are multiples, below 2^24, of a power of
    two, none is -0, and this is shorter.

    Args:
        weights: of all matrices, one after another, each row-major.
        mode: one of MODES.
        matrices: (rows, columns) of each.

    Raises:
        ValueError: the matrices do not hold n weights.
    """
    word = np.ascontiguousarray(weights, np.float32).view(np.uint32)
    if mode == "float32":
        return _codec.planes_encode(word)
    return _codec.weights_encode(word, np.array(matrices, np.uint32))


def decode(data: bytes | memoryview, matrices: Matrices = MATRICES) -> npt.NDArray[np.float32]:
    """The weights (n,) float32 of ``matrices`` (rows, columns).

    Raises:
        ValueError: the stream is damaged, or holds another number of weights.
    """
    word = np.empty(sum(rows * columns for rows, columns in matrices), np.uint32)
    _codec.weights_decode(data, word, np.array(matrices, np.uint32))
    return word.view(np.float32)
