"""Ordinary Gaussians as the PLY file of 3DGS: float32, nothing is rounded.

Properties: x y z, nx ny nz (0), f_dc_0 to 2, f_rest (all coefficients of red, then of green, then
of blue), opacity (logit), scale (log), rot (w x y z).
"""

from __future__ import annotations

import numpy as np

from clgs.data.ply.table import PlyTable, pack_ply
from clgs.exports.splats.encoded import Encoded
from clgs.scene.gaussians import HostGaussians


def encode_ply(gaussians: HostGaussians) -> Encoded:
    """The file of N Gaussians."""
    count = len(gaussians)
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    zero = np.zeros((count, 3), np.float32)
    parts = (
        (["x", "y", "z"], gaussians.mean),
        (["nx", "ny", "nz"], zero),
        ([f"f_dc_{i}" for i in range(3)], gaussians.sh[:, 0]),
        ([f"f_rest_{i}" for i in range(rest.shape[1])], rest),
        (["opacity"], gaussians.opacity[:, None]),
        ([f"scale_{i}" for i in range(3)], gaussians.log_scale),
        ([f"rot_{i}" for i in range(4)], gaussians.rotation),
    )
    columns = {
        name: np.ascontiguousarray(values[:, i])
        for names, values in parts
        for i, name in enumerate(names)
    }
    return Encoded(pack_ply(PlyTable(columns, ["baked by clgs"])), gaussians)
