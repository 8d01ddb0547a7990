"""Ordinary Gaussians as the PLY file of 3DGS: float32, nothing is rounded.

Positions that are too far from the origin for that are float64.

Properties: x y z, nx ny nz (0), f_dc_0 to 2, f_rest (all coefficients of red, then of green, then
of blue), opacity (logit), scale (log), rot (w x y z).
"""

from __future__ import annotations

import numpy as np

from clgs.data.splats.gaussians import DC, MARK, POSITION, REST, ROTATION, SCALE
from clgs.data.splats.ply import PlyTable, pack_ply
from clgs.exports.splats.encoded import Encoded, file_units, scene_units
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import IDENTITY, SceneTransform
from clgs.scene.world import to_text


def encode_ply(gaussians: HostGaussians, transform: SceneTransform = IDENTITY) -> Encoded:
    """The file of N Gaussians, in the world's units of ``transform``."""
    count = len(gaussians)
    position, log_scale, origin = file_units(gaussians, transform)
    written = position if origin.any() else position.astype(np.float32)
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    parts = (
        (POSITION, written),
        (["nx", "ny", "nz"], np.zeros((count, 3), np.float32)),
        (DC, gaussians.sh[:, 0]),
        ([f"{REST}{i}" for i in range(rest.shape[1])], rest),
        (["opacity"], gaussians.opacity[:, None]),
        (SCALE, log_scale),
        (ROTATION, gaussians.rotation),
    )
    columns = {
        name: np.ascontiguousarray(values[:, i])
        for names, values in parts
        for i, name in enumerate(names)
    }
    comments = ["baked by clgs", *[MARK] * gaussians.antialiased]
    if world := to_text(transform.frame, transform.place):
        comments.append(world)
    table = PlyTable(columns, comments)
    return Encoded(pack_ply(table), scene_units(gaussians, written, log_scale, transform))
