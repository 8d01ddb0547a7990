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
from clgs.exports.splats.encoded import Encoded, logit, sigmoid, unit_rotation
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
    largest, small = _smallest_three(unit_rotation(gaussians.rotation))
    rest = _bytes(gaussians.sh[:, 1:] * SH_STEPS + SH_STEPS)
    head = struct.pack("<IIIBBBB", MAGIC, VERSION, len(gaussians), gaussians.degree, fraction, 0, 0)
    parts = (
        position.astype("<i4").view(np.uint8).reshape(len(gaussians), 3, 4)[..., :3],
        *(opacity, color, scale),
        _pack_rotations(largest, small),
        rest,
    )
    data = head + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    stored = OrdinaryGaussians(
        mean=(position / 2.0**fraction).astype(np.float32),
        log_scale=(scale / SCALE_STEPS + SCALE_LEAST).astype(np.float32),
        rotation=_rotations(largest, small),
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


def _smallest_three(
    unit: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Index (N,) of the largest of x y z w, and the others (N, 3) in steps, in that order."""
    q = unit[:, [1, 2, 3, 0]]
    largest = np.argmax(np.abs(q), axis=1)
    q *= np.where(q[np.arange(len(q)), largest] < 0, -1.0, 1.0)[:, None]
    small = q[_others(largest)].reshape(-1, 3)
    return largest, np.rint(small * np.sqrt(2) * ROTATION_STEPS).astype(np.int64)


def _others(largest: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """(N, 4): which components are not the largest."""
    return np.asarray(np.arange(4) != largest[:, None])


def _pack_rotations(
    largest: npt.NDArray[np.int64], small: npt.NDArray[np.int64]
) -> npt.NDArray[np.uint32]:
    """Two bits for the largest, then sign and size of the others, 10 bits each."""
    words = largest
    for i in range(3):
        words = words << 10 | (small[:, i] < 0) << 9 | np.abs(small[:, i])
    return words.astype("<u4")


def _rotations(
    largest: npt.NDArray[np.int64], small: npt.NDArray[np.int64]
) -> npt.NDArray[np.float32]:
    """Quaternions (N, 4), w x y z, as readers make them."""
    whole = np.zeros((len(largest), 4))
    whole[_others(largest)] = (small / (ROTATION_STEPS * np.sqrt(2))).ravel()
    rest = np.sqrt(np.maximum(0.0, 1.0 - np.square(whole).sum(axis=1)))
    whole[np.arange(len(whole)), largest] = rest
    return whole[:, [3, 0, 1, 2]].astype(np.float32)
