"""The mean gradient of the views of a batch, added up in the order of the views.

    sum = (sum + gradient) * scale

The scale is 1 for all views but the last, where it is 1 / views. One kernel adds wherever the views
were looked at, so that the sum has the same bits for any number of devices.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.shapes import Shapes


def add(device: Device, total: DeviceArray, gradient: DeviceArray, scale: float = 1.0) -> None:
    """Add ``gradient`` to ``total`` and multiply that by ``scale``, in place; both float32.

    Raises:
        ValueError, TypeError: the arrays differ in shape, or are not float32.
    """
    axes = " ".join(f"axis{i}" for i in range(len(total.shape)))
    shapes = Shapes()
    shapes.check("total", total, axes, np.float32)
    shapes.check("gradient", gradient, axes, np.float32)
    if not total.size:
        return
    device.run(
        device.kernel("adam/batch", "batch_add"),
        *by_items(-(-total.size // device.vec)),
        sum=total,
        gradient=gradient,
        total=np.uint32(total.size),
        scale=np.float32(scale),
    )
