"""Stable radix sort of 32-bit keys with a 32-bit value each.

Least significant digit first; digits of up to 11 bits on a CPU and 8 bits on a GPU. The result does
not depend on how the keys are split into chunks.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import scan
from clgs.shapes import Shapes

KEY_BITS = 32
DIGIT_BITS = {"cpu": 11, "gpu": 8}


def by_key(
    device: Device, keys: DeviceArray, values: DeviceArray, bits: int = KEY_BITS
) -> tuple[DeviceArray, DeviceArray]:
    """Keys (n,) uint32 in ascending order of their low ``bits`` bits, and their values (n,) int32.

    Equal keys keep their order. The inputs stay as they are.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype, or bits is not in 0..32.
    """
    shapes = Shapes()
    shapes.check("keys", keys, "n", np.uint32)
    shapes.check("values", values, "n", np.int32)
    if not 0 <= bits <= KEY_BITS:
        raise ValueError(f"bits: {bits}, expected 0..{KEY_BITS}")
    for shift, width in digits(bits, DIGIT_BITS[device.specialisation]):
        keys, values = _pass(device, keys, values, shift, width)
    return keys, values


def digits(bits: int, widest: int) -> list[tuple[int, int]]:
    """(shift, width) of the fewest digits of equal width that cover the low ``bits`` bits."""
    if bits == 0:
        return []
    passes = -(-bits // widest)
    width = -(-bits // passes)
    return [(shift, min(width, bits - shift)) for shift in range(0, bits, width)]


def _pass(
    device: Device, keys: DeviceArray, values: DeviceArray, shift: int, width: int
) -> tuple[DeviceArray, DeviceArray]:
    count = len(keys)
    chunk, chunks = scan.chunk_plan(device, count)
    group = scan.GROUP_SIZE if device.specialisation == "gpu" else 1
    plan = np.int32(count), np.int32(chunk), np.int32(chunks)
    digit = np.int32(shift), np.uint32(2**width - 1)
    histogram = device.empty((2**width * chunks,), np.int32)
    size = (chunks * group,), (group,)
    device.run(device.kernel("sort", "sort_histogram"), *size, keys, *plan, *digit, histogram)
    place = scan.on_device(device, histogram).offset
    out = device.empty(keys.shape, np.uint32), device.empty(keys.shape, np.int32)
    scatter = device.kernel("sort", "sort_scatter")
    device.run(scatter, *size, keys, values, *plan, *digit, place, *out)
    return out
