"""Photograph trained splats from above and all around: ``splat_capture.py SPLATS FOLDER [UP]``.

SPLATS is a file that `load_splats` reads; UP says which of its axes points up: y (the default) or
-y. FOLDER becomes a capture in Blender's format, with alpha and known poses: an object that no
setting of clgs was chosen on.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from object_capture import FIELD_OF_VIEW, SIZE, write_capture

import clgs
from clgs.data.splats.gaussians import load_splats
from clgs.errors import ClgsError, DataError

VIEWS = {"train": 100, "test": 40}

EXTENT, ALMOST_ALL = 2.2, 0.01
"""Scene units that the splats fill along their longest side, without this share at either end."""

REACH = 2.0
"""Splats further from the middle are left out, scene units."""

UPRIGHT = {"y": 1.0, "-y": -1.0}

LEAST_ALPHA = 1 / 512
"""Where less is covered there is no color."""


def photograph(splats: Path, folder: Path, up: float) -> None:
    """Write the capture; ``up`` is 1 or -1 times the splats' y axis."""
    gaussians = load_splats(splats).gaussians
    least, most = np.quantile(gaussians.mean, [ALMOST_ALL, 1 - ALMOST_ALL], axis=0)
    if not np.max(most - least) > 0:
        raise DataError(f"{splats}: its splats have no extent; name a file with more of them")
    scale = EXTENT / np.max(most - least)
    mean = (gaussians.mean - (least + most) / 2) * scale
    kept = (np.abs(mean) < REACH).all(axis=1)
    to_splats = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, up], [0.0, -up, 0.0]])  # of a world with z up
    focal = 0.5 * SIZE / np.tan(0.5 * FIELD_OF_VIEW)
    lens = np.array([[focal, 0.0, SIZE / 2], [0.0, focal, SIZE / 2], [0.0, 0.0, 1.0]], np.float32)

    def seen_by(camera_to_world: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
        seen = np.eye(4)
        seen[:3, :3] = to_splats @ camera_to_world[:3, :3] * [1.0, -1.0, -1.0]
        seen[:3, 3] = to_splats @ camera_to_world[:3, 3]
        color, alpha, _ = clgs.rasterization(
            mean[kept].astype(np.float32),
            gaussians.rotation[kept],
            np.exp(gaussians.log_scale[kept]) * np.float32(scale),
            1 / (1 + np.exp(-gaussians.opacity[kept])),
            gaussians.sh[kept],
            np.linalg.inv(seen)[None].astype(np.float32),
            lens[None],
            SIZE,
            SIZE,
            sh_degree=int(np.sqrt(gaussians.sh.shape[1])) - 1,
        )
        straight = np.where(alpha > LEAST_ALPHA, color / np.maximum(alpha, LEAST_ALPHA), 0.0)
        pixels = np.concatenate([straight, alpha], axis=-1)[0].clip(0, 1)
        return np.rint(255 * pixels).astype(np.uint8)

    write_capture(folder, VIEWS, seen_by)


def main(arguments: list[str]) -> int:
    """Write the capture; exit code 2 for wrong usage, 3 for what cannot be read or is there."""
    if len(arguments) not in (2, 3) or arguments[2:3] not in ([], ["y"], ["-y"]):
        print("usage: splat_capture.py SPLATS FOLDER [y|-y]", file=sys.stderr)
        return 2
    splats, folder, up = (*arguments, "y")[:3]
    if Path(folder).exists():
        print(f"{folder}: exists; choose a new folder", file=sys.stderr)
        return 3
    try:
        with TemporaryDirectory(dir=Path(folder).absolute().parent) as unfinished:
            photograph(Path(splats), Path(unfinished) / "capture", UPRIGHT[up])
            (Path(unfinished) / "capture").rename(folder)
    except (ClgsError, OSError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
