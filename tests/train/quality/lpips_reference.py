"""LPIPS with VGG-16 in plain float64 NumPy, written from its definition, and weights to try it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[np.floating]]

CHANNELS = [[64] * 2, [128] * 2, [256] * 3, [512] * 3, [512] * 3]


def random_weights(seed: int = 0) -> Arrays:
    """Arrays under the names of the published ones; large ones in float16, as those."""
    rng, arrays, inputs, number = np.random.default_rng(seed), {}, 3, 0
    for block, widths in enumerate(CHANNELS):
        for width in widths:
            kernel = rng.standard_normal((3, 3, inputs, width), np.float32)
            kernel *= np.sqrt(2 / (9 * inputs))  # keeps the size of activations (He et al. 2015)
            small = np.float32 if number == 0 else np.float16
            arrays[f"VGG16_0/Conv_{number}/kernel"] = kernel.astype(small)
            bias = 0.1 * rng.standard_normal(width, np.float32)
            arrays[f"VGG16_0/Conv_{number}/bias"] = bias
            inputs, number = width, number + 1
        linear = rng.random((1, 1, inputs, 1), np.float32)
        arrays[f"NetLinLayer_{block}/Conv_0/kernel"] = linear
    return arrays


def load_arrays(path: Path) -> Arrays:
    with np.load(path) as archive:
        return dict(archive)


def lpips(
    arrays: Arrays, first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8]
) -> np.float64:
    """Both pictures (H, W, 3)."""
    total = np.float64(0)
    pictures = zip(_activations(arrays, first), _activations(arrays, second), strict=True)
    for block, (x, y) in enumerate(pictures):
        linear = arrays[f"NetLinLayer_{block}/Conv_0/kernel"].astype(np.float64).ravel()
        total += (np.square(_unit(x) - _unit(y)) @ linear).mean()
    return total


def _activations(arrays: Arrays, picture: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.float64]]:
    """After the last rectifier of each block, (H, W, C)."""
    x = (picture / 255.0 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
    found, number = [], 0
    for block, widths in enumerate(CHANNELS):
        if block:
            height, width = x.shape[0] // 2, x.shape[1] // 2
            cells = x[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1)
            x = cells.max(axis=(1, 3))
        for _ in widths:
            kernel = arrays[f"VGG16_0/Conv_{number}/kernel"].astype(np.float64)
            x = np.maximum(_convolve(x, kernel) + arrays[f"VGG16_0/Conv_{number}/bias"], 0)
            number += 1
        found.append(x)
    return found


def _convolve(
    x: npt.NDArray[np.float64], kernel: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """The sum over the nine shifts, zeros beyond the border."""
    height, width = x.shape[:2]
    padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    return np.asarray(
        sum(
            padded[i : i + height, j : j + width] @ kernel[i, j] for i in range(3) for j in range(3)
        )
    )


def _unit(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return x / (np.sqrt(np.square(x).sum(axis=2, keepdims=True)) + 1e-10)
