"""A scene for the page's tests, and its camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgs.scene.anchors import QuantizationScales, quantize, take
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.synthetic.anchor_scene import anchor_scene

SCALES = QuantizationScales(200.0, 16.0, 16.0, 32.0)


def quantized_scene(gaussians: int, size: int) -> tuple[QuantizedScene, Camera]:
    """About ``gaussians`` neural Gaussians on grey, seen by a camera of ``size`` x ``size``."""
    scene, camera = anchor_scene(gaussians, size, seed=3)
    anchors = quantize(scene.anchors, SCALES)
    _, first = np.unique(anchors.position, axis=0, return_index=True)
    settings = replace(scene.settings, background=(0.5, 0.25, 0.125))
    return QuantizedScene(take(anchors, first), scene.mlps, SCALES, settings), camera
