"""The seeded scenes on which blending is measured: many Gaussians on the screen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clgs.constants import BLUR
from clgs.lab.synthetic.gaussians import (
    SIGMA_SPREAD,
    ProjectedScene,
    covariance2d,
    extent,
    projected_scene,
    whitening,
)

Size = tuple[int, int]


def lognormal_scene(
    rng: np.random.Generator, count: int, size: Size, sigma_median: float
) -> ProjectedScene:
    """Gaussians whose two axes are log-normal, blurred as by the projection.

    Args:
        rng: source of all randomness.
        count: N.
        size: width and height, pixels; centres are spread evenly over them.
        sigma_median: median standard deviation along an axis, pixels.
    """
    axes = sigma_median * np.exp(SIGMA_SPREAD * rng.normal(size=(2, count)))
    xx, xy, yy = covariance2d(axes[0], axes[1], rng.uniform(0, np.pi, count))
    opacity = rng.uniform(0.02, 0.9, count)
    return ProjectedScene(
        mean2d=rng.uniform(0, size, (count, 2)).astype(np.float32),
        whitening=whitening(xx + BLUR, xy, yy + BLUR),
        depth=rng.uniform(1, 10, count).astype(np.float32),
        extent=extent(xx + BLUR, yy + BLUR, opacity),
        color=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        opacity=opacity.astype(np.float32),
    )


BLEND_SCENES: dict[str, tuple[Size, Callable[[np.random.Generator], ProjectedScene]]] = {
    "small 200k": ((400, 400), lambda rng: projected_scene(rng, 200_000, 400, 400, 1.2)),
    "medium 50k": ((800, 800), lambda rng: projected_scene(rng, 50_000, 800, 800, 5.2)),
    "lognormal 10k": ((400, 400), lambda rng: lognormal_scene(rng, 10_000, (400, 400), 3.5)),
    "lognormal 50k": ((400, 400), lambda rng: lognormal_scene(rng, 50_000, (400, 400), 1.55)),
    "lognormal 100k": ((400, 400), lambda rng: lognormal_scene(rng, 100_000, (400, 400), 1.1)),
    "dense 40k": ((400, 400), lambda rng: lognormal_scene(rng, 40_000, (400, 400), 3.5)),
    "needles 20k": ((400, 400), lambda rng: projected_scene(rng, 20_000, 400, 400, 12.0, 400.0)),
}
"""Size of the image and generator, by name."""
