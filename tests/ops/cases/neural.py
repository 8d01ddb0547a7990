"""Anchors and MLP outputs for the tests of the neural Gaussians."""

from __future__ import annotations

import numpy as np

from clgs.constants import K_OFFSETS, OUTPUT_DIM


def case(rng: np.random.Generator, visible: int, anchors: int) -> dict[str, np.ndarray]:
    """output (110, V), visible (V,), position, offset and scaling of A anchors."""
    output = rng.normal(size=(OUTPUT_DIM, visible))
    output[:K_OFFSETS] = np.tanh(output[:K_OFFSETS])
    output[K_OFFSETS : 4 * K_OFFSETS] = rng.uniform(0, 1, (3 * K_OFFSETS, visible))
    values = {
        "output": output,
        "position": rng.uniform(-2, 2, (anchors, 3)),
        "offset": rng.normal(size=(anchors, K_OFFSETS, 3)),
        "scaling": rng.uniform(-6, -1, (anchors, 6)),
    }
    chosen = np.sort(rng.choice(anchors, visible, replace=False)).astype(np.int32)
    return {name: value.astype(np.float32) for name, value in values.items()} | {"visible": chosen}


def widen(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same values, floats in float64."""
    return {n: v.astype(np.float64) if v.dtype == np.float32 else v for n, v in values.items()}


def gradients(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Gradients by the fields of N Gaussians, float32."""
    shapes = {"d_mean": 3, "d_scale": 3, "d_rotation": 4, "d_color": 3}
    values = {name: rng.normal(size=(count, width)) for name, width in shapes.items()}
    values["d_opacity"] = rng.normal(size=count)
    return {name: value.astype(np.float32) for name, value in values.items()}
