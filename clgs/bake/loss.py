"""What baking costs: PSNR of baked Gaussians and of the scene that they were baked from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clgs.bake.bake import BakeView
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.renderer import Renderer
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import Scene, SplatScene
from clgs.train.quality.metrics import psnr_8bit, to_8bit


@dataclass(frozen=True)
class BakedLoss:
    """Mean PSNR over ``views`` views, in dB: of the baked Gaussians and of the scene.

    Against the photos; without photos ``baked`` is against the scene, and ``scene`` None.
    """

    views: int
    baked: float
    scene: float | None


def baked_loss(
    device: Device,
    scene: Scene,
    gaussians: HostGaussians,
    views: Sequence[BakeView],
    options: RenderOptions = DEFAULT,
) -> BakedLoss:
    """Draw both from ``views`` and compare; ``gaussians`` in scene units."""
    renderer = Renderer(device, scene, options)
    of_baked = Renderer(device, SplatScene(gaussians, scene.settings), options)
    baked, before = [], []
    for view in views:
        whole = to_8bit(renderer.render(view.camera))
        picture = to_8bit(of_baked.render(view.camera))
        if view.photo is None:
            baked.append(psnr_8bit(picture, whole))
            continue
        photo = np.ascontiguousarray(view.photo().transpose(1, 2, 0))
        baked.append(psnr_8bit(picture, photo))
        before.append(psnr_8bit(whole, photo))
    return BakedLoss(len(views), float(np.mean(baked)), float(np.mean(before)) if before else None)
