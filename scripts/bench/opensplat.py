"""A data set for OpenSplat, and the score of what it made of it.

    python scripts/bench/opensplat.py data DATA DOWNSCALE FOLDER
    opensplat FOLDER --cpu --keep-crs --save-every 10 -o FOLDER/splats.ply
    python scripts/bench/opensplat.py score DATA DOWNSCALE FOLDER/splats_*.ply

FOLDER receives what ``clgs train`` reads of DATA: the training photos at their reduced size, their
cameras, and the points to start from. The score is the PSNR of the photos that are held out.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import clgs
from clgs.data.dataset import Dataset
from clgs.train.quality.scores import mean_psnr
from clgs.train.run.load import with_points

OPENGL = np.array([1, -1, -1, 1])
"""Signs of the axes of nerfstudio's cameras: y up, z back."""


def write(data: Dataset, folder: Path) -> None:
    """Write photos, transforms.json and points.ply, in scene units."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for view in data.train:
        name, camera, pose = f"images/{len(frames):04}.png", view.camera, np.eye(4)
        Image.fromarray(view.photo.pixels().color).save(folder / name)
        pose[:3, :3], pose[:3, 3] = camera.rotation, camera.translation
        frames.append(
            {
                "file_path": name,
                "transform_matrix": (np.linalg.inv(pose) * OPENGL).tolist(),
                "fl_x": camera.fx,
                "fl_y": camera.fy,
                "cx": camera.cx,
                "cy": camera.cy,
                "w": camera.width,
                "h": camera.height,
            }
        )
    scene = {**frames[0], "camera_model": "OPENCV", "ply_file_path": "points.ply", "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(scene))
    points = np.zeros(len(data.points), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    points["xyz"] = data.points
    points["rgb"] = 128 if data.point_colors is None else data.point_colors
    properties = [f"property float {axis}" for axis in "xyz"]
    properties += [f"property uchar {color}" for color in ("red", "green", "blue")]
    kind = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header = "\n".join([*kind, *properties, "end_header\n"])
    (folder / "points.ply").write_bytes(header.encode() + points.tobytes())


def score(data: Dataset, paths: list[str]) -> None:
    """Print the PSNR of the photos that are held out, of each file."""
    device = clgs.Device()
    for path in paths:
        scene = clgs.load_splats(path)
        found = mean_psnr(clgs.Renderer(device, scene), data.test, scene.settings.background)
        print(f"{path}: {len(scene.gaussians):,} splats, {found:.2f} dB held out")


if __name__ == "__main__":
    task, source, downscale, *rest = sys.argv[1:]
    dataset = clgs.load_dataset(source, downscale=int(downscale))
    if task == "data":
        write(with_points(dataset), Path(rest[0]))
    else:
        score(dataset, rest)
