"""Ordinary Gaussians as an SPZ file, version 3; ``clgs.data.splats.spz`` says what it holds."""

from __future__ import annotations

import gzip
import logging

import numpy as np
import numpy.typing as npt

from clgs.data.splats.spz import (
    ANTIALIASED_FLAG,
    COLOR_SCALE,
    HEAD,
    MAGIC,
    ROTATION_STEPS,
    SCALE_LEAST,
    SCALE_STEPS,
    SH_STEPS,
    decode_spz,
)
from clgs.errors import DataError
from clgs.exports.splats.ply import Encoded, as_read, file_units
from clgs.scene.gaussians import HostGaussians, sigmoid, smallest_three, unit_rotation
from clgs.scene.scene import IDENTITY, SceneTransform

_log = logging.getLogger(__name__)

VERSION = 3
FIXED_BITS = 23
"""The bits of a coordinate without its sign."""
MAX_FRACTION = 20
MANY_SMALL = 0.01
"""A smaller share is usual: splats that are drawn as points in any case."""

LEVEL = 9
"""The level of gzip."""


def encode_spz(gaussians: HostGaussians, transform: SceneTransform = IDENTITY) -> Encoded:
    """The file of N Gaussians, in the world's units of ``transform``.

    Raises:
        DataError: a coordinate is too large.
    """
    position, log_scale, _ = file_units(gaussians, transform)
    fraction = fraction_bits(position)
    fixed = np.rint(position * 2.0**fraction).astype("<i4")
    most = SCALE_LEAST + 255 / SCALE_STEPS
    if count := int((log_scale > most + 0.5 / SCALE_STEPS).any(axis=1).sum()):
        _log.warning(
            "%d Gaussians are larger than the %.0f units that .spz can hold, and are made smaller; "
            "write .ply to keep them",
            *(count, np.exp(most)),
        )
    small = float((log_scale.max(axis=1) < SCALE_LEAST).mean())
    if small > MANY_SMALL:
        _log.warning(
            "%.0f %% of the Gaussians are smaller than the %.1g units that .spz can hold, and are "
            "made larger; write .ply, or give --units scene",
            *(100 * small, np.exp(SCALE_LEAST)),
        )
    color = gaussians.sh[:, 0].astype(np.float64) * COLOR_SCALE + 127.5
    if count := int(((color < -0.5) | (color > 255.5)).any(axis=1).sum()):
        _log.warning(
            "%d Gaussians are brighter or darker than .spz can hold, and are cut; "
            "write .ply to keep them",
            count,
        )
    largest, others = smallest_three(unit_rotation(gaussians.rotation)[:, [1, 2, 3, 0]])  # x y z w
    small = np.rint(others * np.sqrt(2) * ROTATION_STEPS).astype(np.int64)
    words = largest  # two bits, then sign and size of each of the others, 10 bits
    for i in range(3):
        words = words << 10 | (small[:, i] < 0) << 9 | np.abs(small[:, i])
    flags = ANTIALIASED_FLAG if gaussians.antialiased else 0
    count, degree = len(gaussians), gaussians.degree
    parts = (
        fixed.view(np.uint8).reshape(count, 3, 4)[..., :3],
        _bytes(sigmoid(gaussians.opacity) * 255),
        _bytes(color),
        _bytes((log_scale - SCALE_LEAST) * SCALE_STEPS),
        words.astype("<u4"),
        _bytes(gaussians.sh[:, 1:].astype(np.float64) * SH_STEPS + SH_STEPS),
    )
    head = HEAD.pack(MAGIC, VERSION, count, degree, fraction, flags, 0)
    data = head + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    packed = gzip.compress(data, LEVEL, mtime=0)
    return Encoded(packed, as_read(decode_spz(packed), transform))


def fraction_bits(position: npt.NDArray[np.float64]) -> int:
    """How many bits after the point the largest coordinate of (N, 3) leaves.

    Raises:
        DataError: none.
    """
    largest = float(np.abs(position).max(initial=0.0))
    if not largest < 2.0 ** (FIXED_BITS - 1):
        raise DataError(
            f"a coordinate is {largest:.3g}: too large for .spz; write .ply, or give --units scene"
        )
    return min(MAX_FRACTION, FIXED_BITS - 1 - int(np.floor(np.log2(max(largest, 0.5)))))


def _bytes(values: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    return np.asarray(np.clip(np.rint(values), 0, 255).astype(np.uint8))
