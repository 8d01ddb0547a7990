"""Ordinary Gaussians as an SPZ file, version 3: quantised and compressed by gzip.

A header of 16 bytes, then by attribute: positions (24-bit fixed point), opacities, base colors,
log scales (bytes), rotations (the three smallest components of the quaternion, 10 bits each), and
the other coefficients of the color (bytes, coefficient by coefficient, channels within). The axes
stay as they are: splat-transform and gsply turn none either between PLY and SPZ.

Source of the format: Niantic's description (github.com/nianticlabs/spz, README).
"""

from __future__ import annotations

import gzip
import logging
import struct

import numpy as np
import numpy.typing as npt

from clgs.errors import DataError
from clgs.exports.splats.encoded import (
    Encoded,
    from_smallest_three,
    logit,
    sigmoid,
    smallest_three,
    unit_rotation,
)
from clgs.scene.gaussians import HostGaussians, OrdinaryGaussians

_log = logging.getLogger(__name__)

MAGIC, VERSION = 0x5053474E, 3
FIXED_BITS = 23
"""The bits of a coordinate without its sign."""
MAX_FRACTION = 20
COLOR_SCALE = 0.15 * 255
SCALE_STEPS, SCALE_LEAST = 16.0, -10.0
"""The steps per unit of a log scale, and the least log scale."""
SH_STEPS = 128.0
ROTATION_STEPS = 511
LEVEL = 9
"""The level of gzip."""


def encode_spz(gaussians: HostGaussians) -> Encoded:
    """The file of N Gaussians.

    Raises:
        DataError: a coordinate is too large.
    """
    fraction = _fraction_bits(gaussians)
    position = np.rint(gaussians.mean * 2.0**fraction).astype(np.int32)
    opacity = _bytes(sigmoid(gaussians.opacity) * 255)
    color = _bytes(gaussians.sh[:, 0] * COLOR_SCALE + 127.5)
    scale = _bytes((gaussians.log_scale - SCALE_LEAST) * SCALE_STEPS)
    most = SCALE_LEAST + 255 / SCALE_STEPS
    if count := int((gaussians.log_scale > most + 0.5 / SCALE_STEPS).any(axis=1).sum()):
        # tiny ones are drawn as points in any case
        _log.warning(
            "%d Gaussians are larger than the %.0f units that .spz can hold, and are made smaller; "
            "write .ply to keep them",
            *(count, np.exp(most)),
        )
    largest, others = smallest_three(unit_rotation(gaussians.rotation)[:, [1, 2, 3, 0]])  # x y z w
    small = np.rint(others * np.sqrt(2) * ROTATION_STEPS).astype(np.int64)
    words = largest  # two bits, then sign and size of each of the others, 10 bits
    for i in range(3):
        words = words << 10 | (small[:, i] < 0) << 9 | np.abs(small[:, i])
    rotation = from_smallest_three(largest, small / (ROTATION_STEPS * np.sqrt(2)))
    rest = _bytes(gaussians.sh[:, 1:] * SH_STEPS + SH_STEPS)
    head = struct.pack("<IIIBBBB", MAGIC, VERSION, len(gaussians), gaussians.degree, fraction, 0, 0)
    parts = (
        position.astype("<i4").view(np.uint8).reshape(len(gaussians), 3, 4)[..., :3],
        *(opacity, color, scale),
        words.astype("<u4"),
        rest,
    )
    data = head + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    stored = OrdinaryGaussians(
        mean=(position / 2.0**fraction).astype(np.float32),
        log_scale=(scale / SCALE_STEPS + SCALE_LEAST).astype(np.float32),
        rotation=rotation[:, [3, 0, 1, 2]].astype(np.float32),
        opacity=logit(opacity / 255.0),
        sh=np.concatenate(
            [(color[:, None] - 127.5) / COLOR_SCALE, (rest - SH_STEPS) / SH_STEPS], axis=1
        ).astype(np.float32),
    )
    return Encoded(gzip.compress(data, LEVEL, mtime=0), stored)


def _fraction_bits(gaussians: HostGaussians) -> int:
    """How many bits after the point the largest coordinate leaves."""
    largest = float(np.abs(gaussians.mean).max(initial=0.0))
    if not largest < 2.0 ** (FIXED_BITS - 1):
        raise DataError(
            f"a coordinate is {largest:.3g}: too large for .spz; write .ply, or give "
            "--units scene if the scene was trained"
        )
    return min(MAX_FRACTION, FIXED_BITS - 1 - int(np.floor(np.log2(max(largest, 0.5)))))


def _bytes(values: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    return np.asarray(np.clip(np.rint(values), 0, 255).astype(np.uint8))
