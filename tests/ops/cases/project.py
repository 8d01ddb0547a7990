"""Gaussians in front of a camera, for the tests of projection."""

from __future__ import annotations

from typing import Any

import numpy as np

from clgs.ops.neural import Gaussians
from clgs.ops.project import ProjectedGradients
from clgs.scene.camera import Camera


def camera_at(focal: float = 400.0, width: int = 320, height: int = 240) -> Camera:
    """A camera 4 units before the origin, turned a little, principal point off centre."""
    angle = 0.3
    rotation = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    return Camera(
        rotation,
        np.array([0.1, -0.2, 4.0]),
        focal,
        1.1 * focal,
        0.45 * width,
        0.55 * height,
        width,
        height,
    )


def gaussians(rng: np.random.Generator, count: int, ratio: float = 10.0) -> dict[str, np.ndarray]:
    """Random Gaussians, float32; longest to shortest axis up to ``ratio``."""
    quaternion = rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    scale = 0.03 * ratio ** rng.uniform(-0.5, 0.5, (count, 3))
    values = {
        "mean": rng.uniform(-1.2, 1.2, (count, 3)),
        "scale": scale,
        "rotation": quaternion,
        "opacity": rng.uniform(0.01, 1.0, count),
    }
    return {name: value.astype(np.float32) for name, value in values.items()}


def on_device(device: Any, values: dict[str, np.ndarray]) -> Gaussians:
    """The Gaussians on a device, black."""
    color = device.upload(np.zeros_like(values["mean"]))
    return Gaussians(**{name: device.upload(v) for name, v in values.items()}, color=color)


def d_projected(device: Any, d_mean2d: np.ndarray, d_whitening: np.ndarray) -> ProjectedGradients:
    """Gradients by projections, those by color and opacity zero."""
    count = len(d_mean2d)
    by_light = device.zeros((count, 3)), device.zeros((count,))
    return ProjectedGradients(device.upload(d_mean2d), device.upload(d_whitening), *by_light)


def widen(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same values in float64."""
    return {name: value.astype(np.float64) for name, value in values.items()}
