"""The image loss and the volume term in float64, from the definition of SSIM.

Moments are sums over an explicit, zero-padded window; the gradient runs the same sums backwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import SSIM_C1, SSIM_C2, SSIM_SIGMA, SSIM_WINDOW

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LossValue:
    """Mean absolute error, SSIM and their weighted sum."""

    l1: float
    ssim: float
    value: float


def window() -> Array:
    """The Gaussian window along one axis (SSIM_WINDOW,), sum 1."""
    distance = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    weights = np.exp(-0.5 * (distance / SSIM_SIGMA) ** 2)
    return np.asarray(weights / weights.sum())


def blur(planes: Array) -> Array:
    """Weighted mean of (3, H, W) under the window around every pixel; zero outside."""
    radius = SSIM_WINDOW // 2
    for axis in (1, 2):
        padding = [(0, 0), (0, 0), (0, 0)]
        padding[axis] = (radius, radius)
        padded = np.pad(planes, padding)
        length = planes.shape[axis]
        planes = sum(
            (w * padded.take(range(tap, tap + length), axis) for tap, w in enumerate(window())),
            start=np.zeros_like(planes),
        )
    return planes


def ssim_map(image: Array, target: Array) -> Array:
    """SSIM of every pixel and channel (3, H, W)."""
    mu_x, mu_y = blur(image), blur(target)
    variances = blur(image**2) - mu_x**2 + blur(target**2) - mu_y**2
    covariance = blur(image * target) - mu_x * mu_y
    luminance = (2 * mu_x * mu_y + SSIM_C1) / (mu_x**2 + mu_y**2 + SSIM_C1)
    return (2 * covariance + SSIM_C2) / (variances + SSIM_C2) * luminance


def to_levels(target: npt.NDArray[np.uint8]) -> Array:
    """Pixels as fractions of 255, rounded to float32 as the kernels see them (ties of L1)."""
    return np.asarray((target / 255.0).astype(np.float32), np.float64)


def forward(
    image: Array, target: npt.NDArray[np.uint8], l1_weight: float = 0.8, ssim_weight: float = 0.2
) -> LossValue:
    """Compare ``image`` (3, H, W) with ``target`` (3, H, W) uint8."""
    levels = to_levels(target)
    l1 = float(np.mean(np.abs(image - levels)))
    ssim = float(np.mean(ssim_map(image, levels)))
    return LossValue(l1, ssim, l1_weight * l1 + ssim_weight * (1 - ssim))


def backward(
    image: Array, target: npt.NDArray[np.uint8], l1_weight: float = 0.8, ssim_weight: float = 0.2
) -> Array:
    """d_image (3, H, W) of ``forward(...).value``."""
    levels = to_levels(target)
    mu_x, mu_y = blur(image), blur(levels)
    b1 = mu_x**2 + mu_y**2 + SSIM_C1
    b2 = blur(image**2) - mu_x**2 + blur(levels**2) - mu_y**2 + SSIM_C2
    a1 = 2 * mu_x * mu_y + SSIM_C1
    a2 = 2 * (blur(image * levels) - mu_x * mu_y) + SSIM_C2
    d_square = -a1 * a2 / (b1 * b2**2)  # by the blurred x^2, and so on
    d_product = 2 * a1 / (b1 * b2)
    d_mean = 2 * mu_y * a2 / (b1 * b2) - 2 * mu_x * a1 * a2 / (b1**2 * b2)
    d_mean -= 2 * mu_x * d_square + mu_y * d_product
    # the window is symmetric, hence its own transpose
    d_ssim = blur(d_mean) + 2 * image * blur(d_square) + levels * blur(d_product)
    return (l1_weight * np.sign(image - levels) - ssim_weight * d_ssim) / image.size


def volume(scale: Array, weight: float) -> tuple[float, Array]:
    """Mean product of scales (N, 3), without ``weight``; and ``weight`` times its gradient."""
    if len(scale) == 0:
        return 0.0, np.zeros_like(scale)
    others = scale[:, [1, 2, 0]] * scale[:, [2, 0, 1]]
    return float(scale.prod(axis=1).mean()), weight / len(scale) * others
