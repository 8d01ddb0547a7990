"""Rows of integers by the two coders that need no model: run lengths, and the paper's coder."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs import _codec

Ints = npt.NDArray[np.int32]


def encode_run_lengths(rows: Ints) -> bytes:
    """The run-length stream of ``rows`` (n, channels) int32, 1 to 256 channels."""
    return _codec.runlength_encode(np.ascontiguousarray(rows, np.int32), rows.shape[1])


def decode_run_lengths(data: bytes | memoryview, count: int, channels: int) -> Ints:
    """The rows (count, channels) int32 of a stream; the caller has bounded ``count``.

    Raises:
        ValueError: the stream is damaged, or holds another number of rows.
    """
    rows = np.empty((count, channels), np.int32)
    _codec.runlength_decode(data, rows, channels)
    return rows


def encode_paper(rows: Ints) -> bytes:
    """The stream of ``rows`` (n, channels) int32 by the coder that the paper uses."""
    return _codec.paper_encode(np.ascontiguousarray(rows, np.int32), rows.shape[1])


def decode_paper(data: bytes | memoryview, count: int, channels: int) -> Ints:
    """The rows (count, channels) int32 of a stream of ``encode_paper``.

    Raises:
        ValueError: the stream is damaged, or holds another number of rows.
    """
    rows = np.empty((count, channels), np.int32)
    _codec.paper_decode(data, rows, channels)
    return rows
