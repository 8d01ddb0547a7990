"""Anchors and weights for the tests of the MLPs."""

from __future__ import annotations

from typing import Any

import numpy as np

from clgs.constants import FEATURE_DIM, K_OFFSETS, NEAR_PLANE
from clgs.ops.mlp import Inputs
from clgs.reference import mlp as reference
from clgs.scene.mlps import init_mlps, unpack_head
from tests.ops.cases.anchors import on_device
from tests.ops.cases.project import camera_at


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


def with_opacity_bias(values: dict[str, np.ndarray], bias: float) -> dict[str, np.ndarray]:
    """The case with ``bias`` added to all opacities before their tanh: how many slots are drawn."""
    weights = values["weights"].copy()
    unpack_head(weights, "opacity")["output_bias"] += np.float32(bias)
    return {**values, "weights": weights}


def mlp_inputs(device: Any, values: dict[str, np.ndarray]) -> Inputs:
    """What the MLPs read of a case, on a device."""
    weights, camera = device.upload(values["weights"]), device.upload(packed_camera())
    return Inputs(on_device(device, values), weights, camera)


def decided(values: dict[str, np.ndarray]) -> np.ndarray:
    """Anchors of which rounding decides nothing, ascending int32.

    Every hidden sum and every opacity is far from zero, compared with 53 roundings of order one.
    """
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    visible = np.arange(len(values["feature"]), dtype=np.int32)
    activations = reference.forward(**wide, visible=visible, camera=packed_camera())
    sums = [
        head.hidden_weight @ activations.input[:-1] + head.hidden_bias[:, None]
        for head in reference.heads(wide["weights"])
    ]
    nearest = np.abs(np.concatenate([*sums, activations.output[:K_OFFSETS]])).min(axis=0)
    return visible[nearest > 2.0**-18]


def some(rng: np.random.Generator, count: int, of: int) -> np.ndarray:
    """``count`` of ``of`` anchors, ascending int32."""
    return np.sort(rng.choice(of, count, replace=False)).astype(np.int32)
