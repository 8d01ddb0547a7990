"""How many bits integers take if each channel is coded by its own frequencies."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt


def entropy_bits(integers: npt.NDArray[np.integer]) -> float:
    """Bits of all of the integers (A, ...), every index after the first being a channel.

    The zeroth-order entropy of each channel, summed: what an ideal coder takes that knows the
    channel's histogram and no context. The rate proxy's Laplace law says more if many are 0.
    """
    bits = 0.0
    channels = math.prod(integers.shape[1:])
    for channel in integers.reshape(len(integers), channels).T:
        _, counts = np.unique(channel, return_counts=True)
        bits += float((counts * np.log2(len(channel) / counts)).sum())
    return bits
