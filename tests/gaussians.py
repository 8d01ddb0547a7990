"""Seeded Gaussians on the screen and in space, for tests and measurements of single stages."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT

Array = npt.NDArray[np.float32]

SIGMA_SPREAD = 0.5
"""Standard deviation of the logarithm of the sizes."""


@dataclass(frozen=True)
class ProjectedScene:
    """N Gaussians on the screen, float32, as ``clgs.ops.project`` would hand them on.

    mean2d (N, 2) pixels; whitening (N, 3) = r1, l, r2; depth (N,) scene units; extent (N, 2)
    pixels; color (N, 3) in 0..1; opacity (N,) in 0.02..0.9.
    """

    mean2d: Array
    whitening: Array
    depth: Array
    extent: Array
    color: Array
    opacity: Array


@dataclass(frozen=True)
class GaussianScene:
    """N Gaussians in space, float32.

    mean (N, 3), scale (N, 3) in scene units; rotation (N, 4) unit quaternions w x y z; color (N, 3)
    in 0..1; opacity (N,) in 0.02..0.9.
    """

    mean: Array
    scale: Array
    rotation: Array
    color: Array
    opacity: Array


def projected_scene(
    rng: np.random.Generator,
    count: int,
    width: int,
    height: int,
    sigma_median: float = 1.1,
    ratio: float = 3.0,
) -> ProjectedScene:
    """Gaussians spread over an image and a little beyond its edges.

    Args:
        rng: source of all randomness.
        count: N.
        width: pixels.
        height: pixels.
        sigma_median: median of the longer standard deviation, pixels (log-normal).
        ratio: the longer axis is up to this many times the shorter one.
    """
    sigma = sigma_median * np.exp(SIGMA_SPREAD * rng.normal(size=count))
    margin = 2 * sigma_median
    mean2d = rng.uniform((-margin, -margin), (width + margin, height + margin), (count, 2))
    minor = sigma / ratio ** rng.uniform(size=count)
    angle = rng.uniform(0, np.pi, count)
    opacity = rng.uniform(0.02, 0.9, count)
    c, s = np.cos(angle), np.sin(angle)
    xx = (sigma * c) ** 2 + (minor * s) ** 2
    yy = (sigma * s) ** 2 + (minor * c) ** 2
    xy = (sigma**2 - minor**2) * c * s
    # y1 = dx r1 and y2 = (dy - l dx) r2 are uncorrelated
    l_factor = xy / xx
    whitening = np.stack([1 / np.sqrt(xx), l_factor, 1 / np.sqrt(yy - l_factor * xy)], axis=1)
    # half-widths of the box outside of which alpha < ALPHA_CUT
    reach = np.sqrt(2 * np.log(np.maximum(opacity / ALPHA_CUT, 1)))
    extent = reach[:, None] * np.sqrt(np.stack([xx, yy], axis=1))
    return ProjectedScene(
        mean2d=mean2d.astype(np.float32),
        whitening=whitening.astype(np.float32),
        depth=rng.uniform(1, 10, count).astype(np.float32),
        extent=extent.astype(np.float32),
        color=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        opacity=opacity.astype(np.float32),
    )


def gaussian_scene(
    rng: np.random.Generator,
    count: int,
    radius: float = 1.0,
    sigma_median: float = 0.02,
    ratio: float = 4.0,
) -> GaussianScene:
    """Gaussians in a ball around the origin, for cameras that look at it from a few radii.

    Args:
        rng: source of all randomness.
        count: N.
        radius: of the ball, scene units.
        sigma_median: median scale along an axis, scene units (log-normal).
        ratio: largest scale over smallest of one Gaussian, at most.
    """
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    mean = direction * radius * rng.uniform(size=(count, 1)) ** (1 / 3)
    size = sigma_median * np.exp(SIGMA_SPREAD * rng.normal(size=(count, 1)))
    scale = size * ratio ** rng.uniform(-0.5, 0.5, (count, 3))
    rotation = rng.normal(size=(count, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    return GaussianScene(
        mean=mean.astype(np.float32),
        scale=scale.astype(np.float32),
        rotation=rotation.astype(np.float32),
        color=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        opacity=rng.uniform(0.02, 0.9, count).astype(np.float32),
    )
