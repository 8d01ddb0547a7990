"""Arrays of pyopencl that a program holds: read where they lie."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
import pyopencl.array as cl_array

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device


def lent_array(device: Device, name: str, value: Any) -> DeviceArray | None:
    """The memory of a ``pyopencl.array.Array``, of which no part is copied; None if it is none.

    Waits for the commands that pyopencl knows to write to it. An array that begins within its
    buffer is copied, on the device.

    Raises:
        ValueError: it is of another context, or not contiguous; ``name`` names it.
    """
    if isinstance(value, DeviceArray):
        return value
    if not isinstance(value, cl_array.Array):
        return None
    if value.context != device.context:
        raise ValueError(
            f"{name}: {value.shape} is of another context; make it with the queue of the "
            "clgs.Device that is given as device"
        )
    if not value.flags.c_contiguous:
        raise ValueError(f"{name}: {value.shape} is not contiguous")
    if not value.size:
        return device.empty(value.shape, value.dtype)
    whole = value.copy() if value.offset else value
    whole.finish()
    return DeviceArray(whole.base_data, whole.shape, whole.dtype)


def on_host(device: Device, name: str, value: Any) -> npt.NDArray[Any]:
    """A lent array as the host sees it, without a copy on a CPU; anything else as it is.

    Raises:
        ValueError: as of :func:`lent_array`.
    """
    array = lent_array(device, name, value)
    result: npt.NDArray[Any] = value if array is None else device.hand_over(array)
    return result
