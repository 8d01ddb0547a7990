"""Make a tiny Blender-format capture: ``python scripts/make_capture.py FOLDER``.

A sphere with a chequered surface on black, ray-cast in NumPy from cameras around it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

SIZE = 64
FIELD_OF_VIEW = 0.69
CAMERA_RADIUS = 4.0
VIEWS = {"train": 12, "test": 3}


def main(arguments: list[str]) -> int:
    """Write the capture; exit code 2 for wrong usage, 3 for a folder that is there."""
    if len(arguments) != 1 or arguments[0].startswith("-"):
        print("usage: make_capture.py FOLDER", file=sys.stderr)
        return 2
    folder = Path(arguments[0])
    if folder.exists():
        print(f"make_capture: {folder} exists already; name a new folder", file=sys.stderr)
        return 3
    for split, count in VIEWS.items():
        (folder / split).mkdir(parents=True)
        frames = []
        for number in range(count):
            pose = camera_to_world(number / count + 0.3 * (split == "test") / count, number)
            Image.fromarray(photograph(pose)).save(folder / split / f"r_{number}.png")
            name = f"./{split}/r_{number}"
            frames.append({"file_path": name, "transform_matrix": pose.tolist()})
        description = {"camera_angle_x": FIELD_OF_VIEW, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(description))
    return 0


def camera_to_world(turn: float, number: int) -> npt.NDArray[np.float64]:
    """Pose (4, 4) that looks at the origin; Blender's axes: x right, y up, z backward."""
    angle, height = 2 * np.pi * turn, (-0.3, 0.2, 0.6)[number % 3]
    back = np.array([np.cos(angle), np.sin(angle), height])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, CAMERA_RADIUS * back], axis=1)
    return pose


def photograph(pose: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """RGBA picture (SIZE, SIZE, 4) of the unit sphere."""
    focal = 0.5 * SIZE / np.tan(0.5 * FIELD_OF_VIEW)
    x, y = (np.mgrid[0:SIZE, 0:SIZE][::-1] + 0.5 - 0.5 * SIZE) / focal
    ray = np.stack([x, -y, -np.ones_like(x)], -1) @ pose[:3, :3].T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ pose[:3, 3]
    depth = along**2 - (CAMERA_RADIUS**2 - 1.0)
    hit = depth > 0.0
    point = pose[:3, 3] + (-along - np.sqrt(np.where(hit, depth, 0.0)))[..., None] * ray
    chequer = (np.floor(3.0 * point).sum(-1) % 2)[..., None]
    color = np.where(chequer > 0, [0.9, 0.8, 0.2], [0.2, 0.3, 0.8])
    shade = 0.6 + 0.4 * (point @ np.array([0.48, 0.6, 0.64]))[..., None]
    picture = np.concatenate([color * shade, np.ones_like(shade)], -1) * hit[..., None]
    return np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
