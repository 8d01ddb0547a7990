"""A few photos of nothing with known poses: enough to train on anywhere, the same everywhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from clgs.exports.image import save_png

VIEWS, EDGE = 8, 64
DISTANCE = 4.0


def write_photos(folder: Path) -> None:
    """A Blender data set of VIEWS photos in the new folder ``folder``.

    Its pixels are made of integers alone, so that every machine writes the same.
    """
    (folder / "train").mkdir(parents=True)
    frames = []
    for view in range(VIEWS):
        y, x = np.mgrid[:EDGE, :EDGE]
        waves = np.stack([8 * x + 3 * y + 20 * view, 5 * y + 9 * view, 4 * (x + y)], axis=-1) % 512
        save_png(
            folder / "train" / f"{view}.png", np.asarray(np.minimum(waves, 511 - waves), np.uint8)
        )
        # camera to world, looking at the origin from one of eight sides (x right, y up, z back)
        right = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)][view]
        length = (right[0] ** 2 + right[1] ** 2) ** 0.5
        c, s = right[0] / length, right[1] / length
        back = [s, -c, 0.0]
        columns = [[c, s, 0.0], [0.0, 0.0, 1.0], back, [DISTANCE * one for one in back]]
        rows = [[column[i] for column in columns] for i in range(3)]
        frames.append(
            {"file_path": f"./train/{view}", "transform_matrix": [*rows, [0.0, 0.0, 0.0, 1.0]]}
        )
    document = {"camera_angle_x": 0.8, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(document))
