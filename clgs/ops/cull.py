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
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.ops import scan
from clgs.options import DEFAULT, RenderOptions
from clgs.scene.anchors import DeviceAnchors
from clgs.shapes import Shapes


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

    ``anchors``: of the whole scene; ``camera``: (26,) float32 from ``Camera.pack``; ``room``: V,
    and EXACT waits for the device to learn it.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    anchors.check(np.float32)
    Shapes().check("camera", camera, "26", np.float32)
    count = len(anchors)
    keep, parts = device.empty((count,), np.int32), scan.parts_of(device, count, device.vec)
    device.run(
        device.kernel("anchors/cull", "cull_test"),
        *scan.counting_grid(device, count, device.vec),
        position=anchors.position,
        scaling=anchors.scaling,
        camera=camera,
        count=np.int32(count),
        smallest=np.float32(options.smallest_anchor),
        keep=keep,
        sums=parts.sum,
    )
    offsets = scan.on_device(device, keep, parts=parts)
    if not options.skips.anchors:
        every = device.empty((count,), np.int32)
        mark = device.kernel("anchors/cull", "cull_mark")
        device.run(mark, *by_items(count), keep=keep, count=np.int32(count), visible=every)
        return Visible(every, offsets.total)
    room = scan.room_for(device, offsets, room)
    visible = Visible(device.empty((room,), np.int32), offsets.total)
    device.run(
        device.kernel("anchors/cull", "cull_compact"),
        *by_items(max(count, room)),
        keep=keep,
        place=offsets.offset,
        count=np.int32(count),
        total=offsets.total,
        capacity=np.int32(room),
        visible=visible.anchor,
    )
    return visible
