"""Find the anchors that a view may see, before anything is decoded.

Each anchor is projected as a Gaussian with scale exp(S[0:3]), S clamped to +-LOG_SCALE_LIMIT, and
identity rotation. With the blurred screen covariance C it is kept where
    z > near   and   the square |p - centre| <= r, r = ceil(3 sqrt(lambda_max(C))),
touches the image's tiles. A NaN in position or scale is culled. A selection: no backward pass.

Source: the prefilter of Scaffold-GS (Lu et al. 2024).
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.ops import scan
from clgs.shapes import Shapes

GROUP_SIZE = 64


def forward(
    device: Device, position: DeviceArray, scaling: DeviceArray, camera: DeviceArray
) -> DeviceArray:
    """Indices (V,) int32 of the anchors that the camera may see, ascending.

    Args:
        device: where the arrays live.
        position: (A, 3) float32, scene units.
        scaling: (A, 6) float32, log of scene units.
        camera: (26,) float32 from ``Camera.pack``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("position", position, "A 3", np.float32)
    shapes.check("scaling", scaling, "A 6", np.float32)
    shapes.check("camera", camera, "26", np.float32)
    count = len(position)
    keep = device.empty((count,), np.int32)
    device.run(
        device.kernel("cull", "cull_test"),
        (round_up(-(-count // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        position,
        scaling,
        camera,
        np.int32(count),
        keep,
    )
    place, total = scan.exclusive(device, keep)
    visible = device.empty((total,), np.int32)
    device.run(
        device.kernel("cull", "cull_compact"),
        (round_up(count, GROUP_SIZE),),
        (GROUP_SIZE,),
        keep,
        place,
        np.int32(count),
        visible,
    )
    return visible
