"""Cameras that lie far from each other."""

from __future__ import annotations

import numpy as np

from clgs.scene.camera import Camera
from clgs.train.quality.rate_control import spread


def cameras(centres: list[float]) -> list[Camera]:
    """Cameras on a line."""
    size = (10.0, 10.0, 4.0, 4.0, 8, 8)
    return [Camera(np.eye(3), np.array([-x, 0.0, 0.0]), *size) for x in centres]


def test_the_farthest_come_first() -> None:
    line = cameras([0.0, 1.0, 2.0, 3.0, 10.0, 11.0, 5.0])
    assert spread(line, 1) == [0]
    assert spread(line, 2) == [0, 5]
    assert spread(line, 3) == [0, 5, 6]
    assert spread(line, 4) == [0, 2, 5, 6]


def test_no_camera_comes_twice() -> None:
    one_place = cameras([1.0] * 5)
    assert spread(one_place, 3) == [0, 1, 2]
    assert spread(one_place, 9) == [0, 1, 2, 3, 4]
    assert spread([], 3) == []
