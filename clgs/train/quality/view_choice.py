"""A few cameras for many: those that lie far from each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clgs.scene.camera import Camera


def spread(cameras: Sequence[Camera], count: int) -> list[int]:
    """The numbers of ``count`` of the cameras, or of all, in rising order.

    The first one, then always the one whose centre is farthest from those chosen before it
    (Gonzalez 1985); of equals the one with the smallest number.
    """
    centre = np.array([camera.centre for camera in cameras])
    distance = np.full(len(cameras), np.inf)
    chosen: list[int] = []
    for _ in range(min(count, len(cameras))):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(centre - centre[chosen[-1]], axis=1))
        distance[chosen] = -1.0
    return sorted(chosen)
