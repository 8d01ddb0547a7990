"""Pictures without gradients: the stages between culling and tiles are one fused stage."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, mlp, project_anchors, tiles
from clgs.options import DEFAULT, RenderOptions
from clgs.render import tile_groups
from clgs.render.frame import Capacity, DeviceScene, DeviceView


@dataclass(frozen=True)
class Picture:
    """A rendered view: image (3, H, W) float32, not clamped, and totals as those of a Frame."""

    image: DeviceArray
    totals: tuple[DeviceArray, DeviceArray, DeviceArray]


def draw(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    capacity: Capacity | None = None,
) -> Picture:
    """Bit-identical to the picture of ``pipeline.view_forward``, but faster."""
    inputs = mlp.Inputs(scene.anchors, scene.weights, view.camera)
    with device.stage("cull"):
        room = capacity.visible if capacity else None
        visible = cull.forward(device, scene.anchors, view.camera, options, room)
    with device.stage("project anchors"):
        room = capacity.gaussians if capacity else None
        projected, total = project_anchors.forward(device, inputs, visible.anchor, options, room)
    if options.max_memory is not None:
        blended, _ = tile_groups.forward(device, projected, view, options)
        return Picture(blended.image, (visible.total, total, blended.tiles.total))
    with device.stage("tiles"):
        room = capacity.entries if capacity else None
        lists = tiles.forward(device, projected, view.size, options, room)
    with device.stage("blend forward"):
        blended = blend.forward(device, projected, lists, view.background, options)
    return Picture(blended.image, (visible.total, total, lists.total))
