"""A tiny Blender-style data set, ray-cast by hand: three coloured balls before a dark wall."""

from pathlib import Path

import numpy as np
from PIL import Image

from tests.data.folders import look_at, opengl, save_json

BALLS = (
    ((0.0, 0.0, 0.0), 0.6, (0.9, 0.3, 0.2)),
    ((0.7, 0.3, 0.2), 0.35, (0.2, 0.8, 0.3)),
    ((-0.6, -0.4, 0.3), 0.4, (0.3, 0.4, 0.9)),
)
ANGLE = 0.8


def photograph(pose: np.ndarray, size: int) -> np.ndarray:
    """(size, size, 4) uint8: shaded balls, transparent elsewhere."""
    focal = 0.5 * size / np.tan(0.5 * ANGLE)
    axis = (np.arange(size) + 0.5 - size / 2) / focal
    x, y = np.meshgrid(axis, -axis)
    ray = np.stack([x, y, -np.ones_like(x)], -1) @ pose[:3, :3].T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    nearest = np.full((size, size), np.inf)
    picture = np.zeros((size, size, 4))
    for centre, radius, color in BALLS:
        offset = pose[:3, 3] - np.array(centre)
        half = ray @ offset
        root = half**2 - (offset @ offset - radius**2)
        distance = np.where(root > 0, -half - np.sqrt(np.maximum(root, 0)), np.inf)
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        point = pose[:3, 3] + np.where(closer, distance, 0)[..., None] * ray
        normal = (point - np.array(centre)) / radius
        shade = 0.35 + 0.65 * np.clip(normal @ np.array([0.4, 0.5, 0.77]), 0, 1)
        picture[closer] = np.append(color, 1.0) * np.append(np.ones(3), 1.0)
        picture[closer, :3] *= shade[closer, None]
    return np.rint(255 * picture).astype(np.uint8)


def write_scene(folder: Path, train: int = 12, test: int = 3, size: int = 40) -> Path:
    """Write transforms_train.json, transforms_test.json and the photos."""
    rng = np.random.default_rng(0)
    for split, count in (("train", train), ("test", test)):
        (folder / split).mkdir(parents=True)
        frames = []
        for number in range(count):
            turn = 2 * np.pi * (number + 0.5 * (split == "test")) / count
            height = rng.uniform(0.2, 0.9)
            eye = 4.0 * np.array([np.cos(turn), np.sin(turn), height])
            pose = opengl(look_at(eye / np.sqrt(1 + height**2)))
            Image.fromarray(photograph(np.array(pose), size)).save(
                folder / split / f"r_{number}.png"
            )
            frames.append({"file_path": f"./{split}/r_{number}", "transform_matrix": pose})
        save_json(folder, {"camera_angle_x": ANGLE, "frames": frames}, f"transforms_{split}.json")
    return folder
