"""Anchors and weights for the tests of the MLPs."""

from __future__ import annotations

import numpy as np

from clgs.constants import FEATURE_DIM, NEAR_PLANE
from clgs.scene.mlps import init_mlps
from tests.ops.project_cases import camera_at


def packed_camera() -> np.ndarray:
    """The packed camera (26,) of all cases."""
    return camera_at().pack(NEAR_PLANE)


def anchors(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """feature (A, F), position (A, 3) and weights (13710,), float32."""
    return {
        "feature": rng.normal(size=(count, FEATURE_DIM)).astype(np.float32),
        "position": rng.uniform(-1.5, 1.5, (count, 3)).astype(np.float32),
        "weights": init_mlps(rng).flat,
    }


def some(rng: np.random.Generator, count: int, of: int) -> np.ndarray:
    """``count`` of ``of`` anchors, ascending int32."""
    return np.sort(rng.choice(of, count, replace=False)).astype(np.int32)
