"""Quantisation: NumPy's own rounding, half to even, in the precision of ``x``."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Float = TypeVar("Float", bound=np.floating)


def forward(x: npt.NDArray[Float], q: float) -> npt.NDArray[Float]:
    """rint(x q) / q."""
    scale = x.dtype.type(q)
    return np.asarray(np.rint(x * scale) / scale, x.dtype)


def elements(x: npt.NDArray[Float], q: npt.NDArray[Float]) -> npt.NDArray[Float]:
    """rint(x q) / q with a q for each element, without -0."""
    return np.asarray(np.rint(x * q) / q + x.dtype.type(0.0), x.dtype)


def integers(x: npt.NDArray[Float], q: float) -> npt.NDArray[np.int32]:
    """rint(x q) as int32."""
    return np.rint(x * x.dtype.type(q)).astype(np.int32)


def backward(d_rounded: npt.NDArray[Float]) -> npt.NDArray[Float]:
    """d_x: the straight-through estimator passes gradients on unchanged."""
    return d_rounded
