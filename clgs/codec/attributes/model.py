"""The model of attribute channels as an array, as codec_c/src/attributes/model.h lays it out."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Ints: TypeAlias = npt.NDArray[np.int32]
Models: TypeAlias = npt.NDArray[Any]

TAPS, CELLS, CLASSES, TABLE, SCALE = 16, 64, 16, 256, 4096
NEAR = -4
"""The row of a tap that looks at the near rows."""

MAX_FACTOR, TAP_CLAMP, MAX_GAIN, MAX_WEIGHT, MAX_SPAN = 2047, 32767, 65535, 8191, 2

CHANNEL = np.dtype(
    [
        ("centre", np.int32),
        ("taps", np.int32),
        ("tap", np.int32, (TAPS, 3)),
        ("gain", np.int32),
        ("weight", np.int32, 3),
        ("span", np.int32),
        ("coder", np.int32),
        ("classes", np.int32),
        ("class_of", np.uint8, CELLS),
        ("frequency", np.uint16, (CLASSES, TABLE)),
    ]
)
"""``clgs_channel``: a tap is channel, row, factor; a weight is own column, row, rows beside."""


def empty_model(channels: int) -> Models:
    """A model (channels,) in which every channel is always 0."""
    model = np.zeros(channels, CHANNEL)
    model["classes"], model["frequency"][:, 0, 0] = 1, SCALE
    return model
