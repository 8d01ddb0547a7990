"""How many Gaussians a scene has, in the sense of the papers that count them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from clgs.constants import K_OFFSETS
from clgs.opencl.device import Device
from clgs.ops import cull, mlp, neural
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene, upload_view
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene


def count_drawn(
    device: Device,
    scene: QuantizedScene,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_camera: Callable[[], None] = lambda: None,
) -> int:
    """Slots of anchors that at least one of ``cameras`` sees with a positive opacity.

    An anchor has K slots, and the opacity of each depends on the direction of view: a slot that no
    camera ever sees with an opacity above 0 is no Gaussian. ``on_camera`` is called after each.
    """
    uploaded = upload_scene(device, scene.dequantize())
    drawn = np.zeros(len(scene.anchors), np.int32)
    for camera in cameras:
        reduced = camera.reduced(options.accuracy.downscale)
        view = upload_view(device, reduced, scene.settings)
        visible = cull.forward(device, uploaded.anchors, view.camera, options)
        inputs = mlp.Inputs(uploaded.anchors, uploaded.weights, view.camera)
        activations = mlp.opacities(device, inputs, visible.anchor, options, K_OFFSETS)
        slots, _ = neural.number(device, activations)
        anchor = device.download(activations.visible)
        seen = anchor >= 0
        drawn[anchor[seen]] |= device.download(slots)[seen]
        on_camera()
    return int((drawn[:, None] >> np.arange(K_OFFSETS) & 1).sum())
