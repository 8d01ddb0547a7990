"""A file of ordinary Gaussians, and what a reader finds in it; the PLY file of 3DGS.

The PLY file has float32, nothing is rounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.splats.gaussians import DC, MARK, POSITION, REST, ROTATION, SCALE, is_far, scene_of
from clgs.data.splats.ply import PlyTable, pack_ply
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import IDENTITY, SceneTransform
from clgs.scene.world import to_text

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Encoded:
    """The bytes of a file, and the Gaussians that it holds after rounding, in scene units."""

    data: bytes
    gaussians: HostGaussians


def file_units(
    gaussians: HostGaussians, transform: SceneTransform
) -> tuple[Floats, npt.NDArray[np.float32], Floats]:
    """Positions (N, 3) and log scales (N, 3) in the world's units, and an origin (3,).

    The origin is 0, or the middle of splats that are too far from 0 for positions in float32.
    """
    position = transform.to_world(gaussians.mean.astype(np.float64))
    log_scale = gaussians.log_scale + np.float32(np.log(1.0 / transform.scale))
    middle = np.median(position, axis=0)
    return position, log_scale, middle if is_far(middle, log_scale) else np.zeros(3)


def scene_units(
    gaussians: HostGaussians,
    position: npt.NDArray[np.floating],
    log_scale: npt.NDArray[np.float32],
    transform: SceneTransform,
) -> HostGaussians:
    """Gaussians with these positions and log scales, which are in the world's units."""
    mean = transform.to_scene(position.astype(np.float64)).astype(np.float32)
    return replace(gaussians, mean=mean, log_scale=log_scale + np.float32(np.log(transform.scale)))


def as_read(table: PlyTable, transform: SceneTransform) -> HostGaussians:
    """The Gaussians of a table as a reader finds it in a file, in scene units."""
    scene = scene_of(table.columns, Path("the new file"))
    position = scene.transform.to_world(scene.gaussians.mean.astype(np.float64))
    return scene_units(scene.gaussians, position, scene.gaussians.log_scale, transform)


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
