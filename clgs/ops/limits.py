"""Kernels that ask what a device can do: what the other stages are measured against.

copy: target = source. fma: CHAINS independent chains x <- x factor + term per lane, starting
at (1 .. CHAINS) / 8, and their sum. rounding: the operations whose last bit drivers disagree about.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.shapes import Shapes

GROUP_SIZE = 64
CHAINS = 6
FACTOR, TERM = 0.75, 0.375


def copy(device: Device, source: DeviceArray, target: DeviceArray) -> None:
    """Copy ``source`` (n,) float32 to ``target`` of the same shape, by a kernel.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("source", source, "n", np.float32)
    shapes.check("target", target, "n", np.float32)
    device.run(
        device.kernel("limits/limits", "limits_copy"),
        (round_up(-(-len(source) // device.vec), GROUP_SIZE),),
        (GROUP_SIZE,),
        source,
        np.uint32(len(source)),
        target,
    )


def fma(device: Device, groups: int, steps: int) -> DeviceArray:
    """The sums (lanes,) float32 of chains of ``steps`` fused multiply-adds, all lanes equal.

    ``groups`` work-groups run; lanes = groups * (1 or GROUP_SIZE work-items) * vector lanes, and
    2 CHAINS steps lanes operations are made.
    """
    group = GROUP_SIZE if device.specialisation == "gpu" else 1
    result = device.empty((groups * group * device.vec,))
    kernel = device.kernel("limits/limits", "limits_fma")
    arguments = np.float32(FACTOR), np.float32(TERM), np.int32(steps)
    device.run(kernel, (groups * group,), (group,), *arguments, result)
    return result


def rounding(device: Device, x: DeviceArray, y: DeviceArray, z: DeviceArray) -> DeviceArray:
    """(4, n) float32: x / y, sqrt(y), x y + z rounded twice, and x y + z rounded once.

    ``x``, ``y`` and ``z`` are (n,) float32. A device whose results are those of IEEE 754 makes the
    bits of every other such device in all stages.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    for name, array in (("x", x), ("y", y), ("z", z)):
        shapes.check(name, array, "n", np.float32)
    result = device.empty((4, len(x)))
    kernel = device.kernel("limits/limits", "limits_rounding")
    size = (round_up(-(-len(x) // device.vec), GROUP_SIZE),), (GROUP_SIZE,)
    device.run(kernel, *size, x, y, z, np.uint32(len(x)), result)
    return result
