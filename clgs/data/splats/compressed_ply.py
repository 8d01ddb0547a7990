"""Compressed PLY files of SuperSplat and splat-transform.

256 splats are a chunk and share the limits of their positions, log scales and, in newer files,
colors. A splat is four words of 32 bits: position and scale of 11, 10 and 11 bits, rotation as the
smallest three components of the quaternion, color and opacity of 8 bits each. The coefficients of
the colors are bytes.

Source of the format: PlayCanvas' reader (github.com/playcanvas/splat-transform).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.splats.numbers import SH_0, from_smallest_three, logit
from clgs.data.splats.table import PlyTable, element_names, parse_elements

CHUNK = 256
PACKED = [f"packed_{part}" for part in ("position", "rotation", "scale", "color")]
SH_RANGE = 8.0

Words = npt.NDArray[np.uint32]
Floats = npt.NDArray[np.float64]


def decode_chunks(data: bytes) -> PlyTable:
    """The columns of a compressed PLY file by the names of 3DGS's properties.

    Raises:
        ValueError: cut, damaged, or not of this kind.
    """
    wanted = ["chunk", "vertex", *(["sh"] if "sh" in element_names(data) else [])]
    elements = parse_elements(data, wanted)
    chunk, vertex = elements["chunk"].columns, elements["vertex"].columns
    for name in PACKED:
        if vertex.get(name, np.zeros(0)).dtype != np.uint32:
            raise ValueError(f"there are chunks, but no property {name} of type uint")
    position, rotation, scale, color = (vertex[name] for name in PACKED)
    count = len(position)
    for name, rows in (("chunk", -(-count // CHUNK)), ("sh", count)):
        if name in elements and len(elements[name]) != rows:
            raise ValueError(
                f"{len(elements[name])} rows of {name} are not those of {count} splats"
            )
    limits = {name: np.repeat(column, CHUNK)[:count] for name, column in chunk.items()}
    columns: dict[str, npt.NDArray[Any]] = {}
    for words, prefix, suffixes in ((position, "", "xyz"), (scale, "scale_", "012")):
        fields = zip("xyz", suffixes, (21, 11, 0), (11, 10, 11), strict=True)
        for axis, suffix, shift, bits in fields:
            columns[prefix + suffix] = _between(limits, prefix + axis, _share(words, shift, bits))
    small = np.stack([_share(rotation, shift, 10) - 0.5 for shift in (20, 10, 0)], 1) * np.sqrt(2)
    unit = from_smallest_three((rotation >> np.uint32(30)).astype(np.int64), small)
    columns |= {f"rot_{i}": unit[:, i] for i in range(4)}
    for i, (primary, shift) in enumerate(zip("rgb", (24, 16, 8), strict=True)):
        share = _share(color, shift, 8)
        value = _between(limits, primary, share) if "min_r" in limits else share
        columns[f"f_dc_{i}"] = (value - 0.5) / SH_0
    columns["opacity"] = logit(_share(color, 0, 8))
    if "sh" in elements:
        columns |= {name: _coefficient(one) for name, one in elements["sh"].columns.items()}
    single = {name: np.asarray(column, np.float32) for name, column in columns.items()}
    return PlyTable(single, elements["vertex"].comments)


def _share(words: Words, shift: int, bits: int) -> Floats:
    """Some bits of each word as a number from 0 to 1."""
    most = (1 << bits) - 1
    return np.asarray((words >> np.uint32(shift) & np.uint32(most)) / most, np.float64)


def _between(limits: dict[str, npt.NDArray[Any]], name: str, share: Floats) -> Floats:
    """The numbers at these shares of the way from the least to the greatest of their chunks."""
    try:
        least, most = (limits[f"{end}_{name}"].astype(np.float64) for end in ("min", "max"))
    except KeyError as error:
        raise ValueError(f"property {error.args[0]} of element chunk is missing") from None
    return np.asarray(least * (1 - share) + most * share)


def _coefficient(column: npt.NDArray[Any]) -> Floats:
    """Coefficients of bytes: the middles of 256 parts of their range, and its ends."""
    if column.dtype != np.uint8:
        raise ValueError("a property of element sh is no uchar")
    share = np.where(column % 255 == 0, column / 255.0, (column + 0.5) / 256.0)
    return np.asarray((share - 0.5) * SH_RANGE)
