"""The anchors that a view may see, in float64, from the definition."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.constants import LOG_SCALE_LIMIT, TILE_SIZE
from clgs.reference.project import Array, covariance2d, unpack


def screen_square(
    position: Array, scaling: Array, camera: npt.NDArray[np.floating]
) -> tuple[Array, Array, Array]:
    """Centre (A, 2) and 3 sigma (A,) on the screen, pixels, and depth (A,), scene units.

    sigma is the largest standard deviation of the anchor's Gaussian: scale exp(scaling[:, :3]),
    no rotation, blurred.
    """
    view = unpack(camera)
    point = position @ view.rotation.T + view.translation
    scale = np.exp(np.clip(scaling[:, :3], -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT))
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (len(position), 1))
    with np.errstate(all="ignore"):
        centre = view.focal * point[:, :2] / point[:, 2:] + view.centre2d
        cov = covariance2d(view, position, scale, identity)
        xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
        largest = 0.5 * (xx + yy) + np.sqrt((0.5 * (xx - yy)) ** 2 + xy**2)
        return centre, 3 * np.sqrt(largest), point[:, 2]


def tiled_size(camera: npt.NDArray[np.floating]) -> Array:
    """Width and height of the image's tiles together, pixels."""
    return np.ceil(unpack(camera).size / TILE_SIZE) * TILE_SIZE


def forward(
    position: Array, scaling: Array, camera: npt.NDArray[np.floating]
) -> npt.NDArray[np.int32]:
    """Indices (V,) of the visible anchors; shapes as in ``clgs.ops.cull.forward``."""
    centre, reach, depth = screen_square(position, scaling, camera)
    radius = np.ceil(reach)
    seen = (depth > unpack(camera).near) & (radius > 0)
    seen &= np.all(centre + radius[:, None] > 0, axis=1)
    seen &= np.all(centre - radius[:, None] < tiled_size(camera), axis=1)
    return np.flatnonzero(seen).astype(np.int32)
