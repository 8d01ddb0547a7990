"""Pictures without gradients, of anchors or of ordinary Gaussians.

Of anchors, the stages between culling and tiles are one fused stage; of ordinary Gaussians, two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, mlp, project, project_anchors, splats, tiles
from clgs.options import DEFAULT, RenderOptions
from clgs.render import tile_groups
from clgs.render.frame import EXACT_ROOM, DeviceScene, DeviceView, Drawable, Room
from clgs.scene.gaussians import DeviceGaussians


@dataclass(frozen=True)
class Picture:
    """A rendered view: image (3, H, W) and transmittance (H, W) float32, not clamped.

    totals are those of a Frame; of ordinary Gaussians the first two are their number. unit: what
    the image is to be multiplied with.
    """

    image: DeviceArray
    transmittance: DeviceArray
    totals: tuple[DeviceArray, DeviceArray, DeviceArray]
    unit: float = 1.0


def draw(
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
) -> Picture:
    """Bit-identical to the picture of ``pipeline.view_forward``, but faster."""
    projected, *totals = _project(device, scene, view, options, room)
    blended = _blend(device, projected, view, options, room)
    totals.append(blended.tiles.total)
    return Picture(blended.image, blended.transmittance, (totals[0], totals[1], totals[2]))


def draw_depth(
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
) -> Picture:
    """The picture if the color of every Gaussian were (its depth, 1, 0), over black.

    Blending is linear in the colors: the first channel, in scene units, is the sum of depths
    weighted as colors are, and the second one the sum of the weights. Waits for the device.
    """
    projected, *totals = _project(device, scene, view, options, room)
    depth = device.download(projected.depth)
    unit = float(depth.max(initial=0.0)) or 1.0  # blending clamps colors to +-1000
    color = np.stack([depth / np.float32(unit), np.ones_like(depth), np.zeros_like(depth)], 1)
    deep = replace(projected, color=device.upload(color))
    dark = replace(view, background=device.zeros((3,)))
    blended = _blend(device, deep, dark, options, room)
    totals.append(blended.tiles.total)
    return Picture(blended.image, blended.transmittance, (totals[0], totals[1], totals[2]), unit)


def _project(
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions,
    room: Room,
) -> tuple[project.Projected, DeviceArray, DeviceArray]:
    """The Gaussians on the screen, and how many anchors are visible and Gaussians there are."""
    if isinstance(scene, DeviceScene):
        return _project_anchors(device, scene, view, options, room)
    return _project_splats(device, scene, view, options)


def _project_anchors(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions,
    room: Room,
) -> tuple[project.Projected, DeviceArray, DeviceArray]:
    inputs = mlp.Inputs(scene.anchors, scene.weights, view.camera)
    with device.stage("cull"):
        visible = cull.forward(device, scene.anchors, view.camera, options, room.visible)
    with device.stage("project anchors"):
        projected, total = project_anchors.forward(
            device, inputs, visible.anchor, options, room.gaussians
        )
    return projected, visible.total, total


def _project_splats(
    device: Device, stored: DeviceGaussians, view: DeviceView, options: RenderOptions
) -> tuple[project.Projected, DeviceArray, DeviceArray]:
    with device.stage("splats forward"):
        gaussians = splats.forward(device, stored, view.camera)
    with device.stage("project forward"):
        projected = project.forward(device, gaussians, view.camera, options)
    total = device.upload(np.array([len(stored)], np.int64))
    return projected, total, total


def _blend(
    device: Device,
    projected: project.Projected,
    view: DeviceView,
    options: RenderOptions,
    room: Room,
) -> blend.Blended:
    if options.max_memory is not None:
        return tile_groups.forward(device, projected, view, options)[0]
    with device.stage("tiles"):
        lists = tiles.forward(device, projected, view.size, options, room.entries)
    with device.stage("blend forward"):
        return blend.forward(device, projected, lists, view.background, options)
