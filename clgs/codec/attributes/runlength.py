"""Attribute rows to bytes and back."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs import _codec


def encode(value: npt.NDArray[np.int32]) -> bytes:
    """The run-length stream of ``value`` (rows, channels) int32, 1 to 256 channels."""
    return _codec.runlength_encode(np.ascontiguousarray(value, np.int32), value.shape[1])


def decode(data: bytes | memoryview, rows: int, channels: int) -> npt.NDArray[np.int32]:
    """The matrix (rows, channels) int32 of a stream; the caller has bounded ``rows``.

    Raises:
        ValueError: the stream is damaged, or holds another number of rows.
    """
    value = np.empty((rows, channels), np.int32)
    _codec.runlength_decode(data, value, channels)
    return value
