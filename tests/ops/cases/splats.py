"""Ordinary Gaussians in front of a camera, for the tests of what it sees of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from clgs.ops.neural import GaussianGradients
from clgs.reference.general.splats import Stored
from clgs.scene.gaussians import HostGaussians, OrdinaryGaussians


def stored(rng: np.random.Generator, count: int, degree: int = 3) -> HostGaussians:
    """Random Gaussians around the origin, float32; their quaternions have any length."""
    values = (
        rng.uniform(-1.2, 1.2, (count, 3)),
        rng.uniform(-5, -2, (count, 3)),
        rng.normal(size=(count, 4)) * rng.uniform(0.1, 5, (count, 1)),
        rng.normal(0, 2, count),
        rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)),
    )
    return OrdinaryGaussians(*(value.astype(np.float32) for value in values))


def widen(gaussians: HostGaussians) -> Stored:
    """The same in float64, as the reference takes them."""
    return Stored(*(array.astype(np.float64) for _, array in gaussians.items()))


def gradients(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Random gradients by the fields of what a camera sees, float32."""
    widths = {"mean": (3,), "scale": (3,), "rotation": (4,), "color": (3,), "opacity": ()}
    return {n: rng.normal(size=(count, *w)).astype(np.float32) for n, w in widths.items()}


def on_device(device: Any, d_seen: dict[str, np.ndarray]) -> GaussianGradients:
    """Them on a device."""
    return GaussianGradients(**{f"d_{n}": device.upload(array) for n, array in d_seen.items()})
