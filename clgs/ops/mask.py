"""Masks of photos: pixels that are not used are zero in render and photo before the loss.

    masked = used * image,    d_image = used * d_masked

as nerfstudio's splatfacto does. The map is its own transpose: one kernel serves both ways.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.shapes import Shapes


def forward(device: Device, image: DeviceArray, used: DeviceArray) -> DeviceArray:
    """The image (3, H, W) float32 with zeros where ``used`` (H, W) uint8 is 0 instead of 1.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("image", image, "3 H W", np.float32)
    shapes.check("used", used, "H W", np.uint8)
    masked = device.empty(image.shape)
    device.run(
        device.kernel("loss/mask", "mask_apply"),
        *by_items(-(-used.size // device.vec)),
        planes=image,
        used=used,
        total=np.uint32(used.size),
        masked=masked,
    )
    return masked


def backward(device: Device, d_masked: DeviceArray, used: DeviceArray) -> DeviceArray:
    """d_image (3, H, W) float32, from the gradient by what :func:`forward` returned, of its shape.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    return forward(device, d_masked, used)
