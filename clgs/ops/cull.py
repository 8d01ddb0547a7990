"""Find the anchors that a view may see, before anything is decoded.

Each anchor is projected as a Gaussian with scale exp(S[0:3]), S clamped to +-LOG_SCALE_LIMIT, and
identity rotation. With the blurred screen covariance C it is kept if
    z > near   and   the square |p - centre| <= r, r = ceil(3 sqrt(lambda_max(C))),
touches the image's tiles. An anchor with a NaN in position or scale is culled. If a smallest anchor
is set, so is one whose 6 sigma on the screen, without the blur, are fewer pixels. A selection has
no backward pass.

Source: the prefilter of Scaffold-GS (Lu et al. 2024).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.ops import scan
from clgs.options import DEFAULT, RenderOptions
from clgs.scene.anchors import DeviceAnchors
from clgs.shapes import Shapes

GROUP_SIZE = 64


@dataclass(frozen=True)
class Visible:
    """``anchor`` (V,) int32, ascending indices of the anchors that the camera may see, then -1.

    total (1,) int64: how many there are; if it is above V, the others are left out.
    """

    anchor: DeviceArray
    total: DeviceArray


def forward(
    device: Device,
    anchors: DeviceAnchors,
    camera: DeviceArray,
    options: RenderOptions = DEFAULT,
    room: int = scan.EXACT,
) -> Visible:
    """Select the anchors that the camera may see.

    With ``options.skips.anchors`` off, V is A, and anchors that are not visible are entries -1: the
    MLPs then have the work of all anchors, and nothing else changes.

    Args:
        device: where the arrays live.
        anchors: of the whole scene; position and scaling are read.
        camera: (26,) float32 from ``Camera.pack``.
        options: ``smallest_anchor`` and the skip of anchors.
        room: V; EXACT waits for the device to learn it.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    anchors.check(np.float32)
    Shapes().check("camera", camera, "26", np.float32)
    count = len(anchors)
    keep, parts = device.empty((count,), np.int32), scan.parts_of(device, count, device.vec)
    sizes = np.int32(count), np.float32(options.smallest_anchor)
    test = device.kernel("anchors/cull", "cull_test")
    grid = scan.counting_grid(device, count, device.vec, GROUP_SIZE)
    device.run(test, *grid, anchors.position, anchors.scaling, camera, *sizes, keep, parts.sum)
    offsets = scan.on_device(device, keep, parts=parts)
    if not options.skips.anchors:
        every = device.empty((count,), np.int32)
        mark = device.kernel("anchors/cull", "cull_mark")
        device.run(mark, *_grid(count), keep, np.int32(count), every)
        return Visible(every, offsets.total)
    room = scan.room_for(device, offsets, room)
    visible = Visible(device.empty((room,), np.int32), offsets.total)
    compact = device.kernel("anchors/cull", "cull_compact")
    limits = np.int32(count), offsets.total, np.int32(room)
    grid = _grid(max(count, room))
    device.run(compact, *grid, keep, offsets.offset, *limits, visible.anchor)
    return visible


def _grid(items: int) -> tuple[tuple[int], tuple[int]]:
    return (round_up(items, GROUP_SIZE),), (GROUP_SIZE,)
