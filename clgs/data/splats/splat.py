"""The .splat files of web viewers (antimatter15/splat): 32 bytes per splat, without a header."""

from __future__ import annotations

import numpy as np

from clgs.data.splats.ply import PlyTable
from clgs.scene.gaussians import SH_0, logit

SUFFIX = ".splat"

ROW = np.dtype(
    [("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)]
)
"""Scales are lengths; the last color is the opacity; 128 is 0 in a rotation, w first."""


def decode_splat(data: bytes) -> PlyTable:
    """The columns of a .splat file by the names of 3DGS's properties.

    Raises:
        ValueError: cut, or of another kind.
    """
    if len(data) % ROW.itemsize:
        raise ValueError(f"{len(data)} bytes are no .splat file, which has 32 per splat")
    rows = np.frombuffer(data, ROW)
    if (rows["scale"] < 0).any():
        raise ValueError("a .splat file with negative scales")
    with np.errstate(divide="ignore"):
        scale = np.log(rows["scale"])
    share = rows["color"] / 255.0
    groups = {
        "f_dc_": (share[:, :3] - 0.5) / SH_0,
        "scale_": scale,
        "rot_": (rows["rotation"] - 128.0) / 128.0,
    }
    columns = {axis: rows["position"][:, i] for i, axis in enumerate("xyz")}
    columns |= {"opacity": logit(share[:, 3])}
    for name, values in groups.items():
        columns |= {f"{name}{i}": column for i, column in enumerate(values.T)}
    return PlyTable({name: column.astype(np.float32) for name, column in columns.items()})
