"""Ordinary Gaussians, and how far two records are apart."""

import numpy as np

from clgs.scene.gaussians import HostGaussians, OrdinaryGaussians


def gaussians(degree: int = 3, count: int = 500, seed: int = 7) -> HostGaussians:
    """Random ones; one has no rotation, one is almost opaque, one almost transparent."""
    rng = np.random.default_rng(seed)
    rotation = rng.normal(size=(count, 4))
    rotation[0] = [1, 0, 0, 0]
    opacity = rng.normal(0, 2, count)
    opacity[1:3] = [12, -12]
    sh = rng.normal(0, 0.1, (count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.5, (count, 3))
    values = (rng.normal(0, 3, (count, 3)), rng.uniform(-6, 0, (count, 3)), rotation, opacity, sh)
    return OrdinaryGaussians(*(np.asarray(value, np.float32) for value in values))


def differences(one: HostGaussians, other: HostGaussians) -> dict[str, float]:
    """The largest difference of each array; rotations as matrices' entries, opacities in [0, 1]."""
    found = {
        name: float(np.abs(array - getattr(other, name)).max(initial=0))
        for name, array in one.items()
        if name not in ("rotation", "opacity")
    }
    unit = [g.rotation / np.linalg.norm(g.rotation, axis=1, keepdims=True) for g in (one, other)]
    found["rotation"] = float(np.abs(np.abs(np.sum(unit[0] * unit[1], axis=1)) - 1).max())
    opaque = [1 / (1 + np.exp(-g.opacity.astype(np.float64))) for g in (one, other)]
    found["opacity"] = float(np.abs(opaque[0] - opaque[1]).max())
    return found
