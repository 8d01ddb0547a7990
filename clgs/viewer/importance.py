"""Which anchors or Gaussians of a scene matter most, to show it with fewer."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene
from clgs.scene.camera import Camera
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import QuantizedScene, SplatScene
from clgs.train.quality.importance import importance_without_views, sensitivity

VIEWS, SIDE = 24, 400
"""Cameras that are enough to tell, and pixels of a side of their pictures."""


def scene_importance(
    device: Device,
    scene: QuantizedScene | SplatScene,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_render: Callable[[], None] = lambda: None,
) -> npt.NDArray[np.float64]:
    """(N,) float64, larger for what matters more.

    Of anchors what ``clgs encode --target-size`` goes by: what some of ``cameras`` lose without
    them, or without cameras the area that they cover. Of ordinary Gaussians opacity times area.
    """
    if isinstance(scene, SplatScene):
        return splat_importance(scene.gaussians)
    if not cameras:
        return importance_without_views(scene)
    uploaded = upload_scene(device, scene.dequantize())
    seen = chosen(cameras)
    found = sensitivity(device, uploaded, scene.settings, seen, options, False, on_render)
    return found.importance.astype(np.float64)


def chosen(cameras: Sequence[Camera]) -> list[Camera]:
    """At most VIEWS of ``cameras``, evenly spread, with smaller pictures."""
    step = max(1, -(-len(cameras) // VIEWS))
    return [one.reduced(-(-max(one.width, one.height) // SIDE)) for one in cameras[::step]]


def splat_importance(gaussians: HostGaussians) -> npt.NDArray[np.float64]:
    """Opacity times the area of the two longest axes, (N,)."""
    opacity = 1 / (1 + np.exp(-np.clip(gaussians.opacity.astype(np.float64), -50, 50)))
    area = np.sort(gaussians.log_scale.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    return np.asarray(opacity * np.exp(np.clip(area, -80.0, 80.0)))
