"""How much a rendered frame holds, padding not counted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.opencl.device import Device
from clgs.render.frame import Frame


@dataclass(frozen=True)
class FrameCounts:
    """Visible anchors, neural Gaussians, and entries of tile lists."""

    visible: int
    gaussians: int
    intersections: int


def count_frame(device: Device, frame: Frame) -> FrameCounts:
    """The true counts of a frame, whose arrays may end in padding."""
    visible = device.download(frame.activations.visible)
    opacity = device.download(frame.gaussians.opacity)
    return FrameCounts(
        visible=int(np.count_nonzero(visible >= 0)),
        gaussians=int(np.count_nonzero(opacity > 0)),
        intersections=int(device.download(frame.tiles.tile_range)[-1]),
    )
