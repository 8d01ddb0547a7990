"""The fixed scenes of `clgs conformance`: the same bits wherever they are made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.lab.selftest.exact_random import ExactRandom
from clgs.scene.anchors import AnchorSet
from clgs.scene.camera import Camera
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import RenderSettings, Scene

TURNED = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
"""A rotation without rounding in its making."""


@dataclass(frozen=True)
class ConformanceScene:
    """A scene, the view of it, and the photo (3, H, W) uint8 that it is compared with."""

    name: str
    scene: Scene
    camera: Camera
    photo: npt.NDArray[np.uint8]


def conformance_scenes() -> list[ConformanceScene]:
    """Small Gaussians seen straight on; large, turned and off-centre ones; needles."""
    straight = Camera(np.eye(3), np.array([0.0, 0, 4]), 80.0, 80.0, 40.0, 24.0, 80, 48)
    turned = Camera(TURNED, np.array([0.0, 0.25, 4]), 90.0, 110.0, 61.5, 40.25, 113, 77)
    return [
        _scene("small", straight, 400, (-4.0, -3.0)),
        _scene("large", turned, 300, (-3.0, -1.5)),
        _scene("needles", straight, 200, (-8.0, -0.5)),
    ]


def _scene(
    name: str, camera: Camera, anchors: int, log_size: tuple[float, float]
) -> ConformanceScene:
    """Anchors in a box of 3 x 2 x 2 around the origin; ``log_size``: range of their log scales."""
    random = ExactRandom(anchors)
    position = random.floats((anchors, 3), -1.0, 1.0) * np.array([1.5, 1, 1], np.float32)
    scene = Scene(
        AnchorSet(
            position,
            random.floats((anchors, K_OFFSETS, 3), -1.0, 1.0),
            random.floats((anchors, FEATURE_DIM), -1.0, 1.0),
            random.floats((anchors, 6), *log_size),
        ),
        Mlps(random.floats((MLP_SIZE,), -0.25, 0.25)),
        RenderSettings(background=(0.25, 0.5, 0.75)),
    )
    return ConformanceScene(name, scene, camera, random.bytes((3, camera.height, camera.width)))
