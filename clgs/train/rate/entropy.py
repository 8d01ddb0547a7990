"""How many bits integers take if each channel is coded by its own frequencies."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

MOST_VALUES = 2**16
"""Counted in a table if they lie within so many integers; else they are sorted, which is slower."""


def entropy_bits(integers: npt.NDArray[np.integer]) -> float:
    """Bits of all of the integers (A, ...), every index after the first being a channel.

    The zeroth-order entropy of each channel, summed: what an ideal coder takes that knows the
    channel's histogram and no context. The rate proxy's Laplace law says more if many are 0.
    """
    bits = 0.0
    channels = math.prod(integers.shape[1:])
    for channel in np.ascontiguousarray(integers.reshape(len(integers), channels).T):
        counts = _frequencies(channel)
        bits += float((counts * np.log2(len(channel) / counts)).sum())
    return bits


def _frequencies(channel: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """How often each of the values occurs."""
    if not len(channel):
        return np.zeros(0, np.int64)
    first = int(channel.min())
    if int(channel.max()) - first > MOST_VALUES:
        counts = np.unique(channel, return_counts=True)[1]
        return np.asarray(counts, np.int64)
    table = np.bincount(channel.astype(np.int64) - first)
    return np.asarray(table[table > 0], np.int64)
