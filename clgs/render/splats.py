"""Ordinary Gaussians to a picture, and the picture's gradient back to them."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, project, splats, tiles
from clgs.ops.neural import Gaussians
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import DeviceView
from clgs.scene.gaussians import DeviceGaussians


@dataclass(frozen=True)
class SplatFrame:
    """One rendered view: what every stage made, for the backward pass."""

    view: DeviceView
    seen: Gaussians
    projected: project.Projected
    blended: blend.Blended

    @property
    def image(self) -> DeviceArray:
        """The picture (3, H, W) float32."""
        return self.blended.image


@dataclass(frozen=True)
class SplatGradients:
    """Gradients of the loss, float32: by what is stored, and d_mean2d (N, 2) in pixels."""

    stored: DeviceGaussians
    d_mean2d: DeviceArray


def splats_forward(
    device: Device, stored: DeviceGaussians, view: DeviceView, options: RenderOptions = DEFAULT
) -> SplatFrame:
    """Render one view; the bits of ``picture.draw``. A memory budget is not obeyed."""
    with device.stage("splats forward"):
        seen = splats.forward(device, stored, view.camera)
    with device.stage("project forward"):
        projected = project.forward(device, seen, view.camera, options)
    with device.stage("tiles"):
        lists = tiles.forward(device, projected, view.size, options)
    with device.stage("blend forward"):
        blended = blend.forward(device, projected, lists, view.background, options)
    return SplatFrame(view, seen, projected, blended)


def splats_backward(
    device: Device, stored: DeviceGaussians, frame: SplatFrame, d_image: DeviceArray
) -> SplatGradients:
    """Gradients of ``sum(d_image * image)``; d_image (3, H, W) float32."""
    camera = frame.view.camera
    with device.stage("blend backward"):
        d_projected = blend.backward(device, frame.projected, frame.blended, d_image)
    with device.stage("project backward"):
        d_seen = project.backward(device, frame.seen, camera, frame.projected, d_projected)
    with device.stage("splats backward"):
        gradients = splats.backward(device, stored, camera, frame.seen, d_seen)
    return SplatGradients(gradients, d_projected.d_mean2d)
