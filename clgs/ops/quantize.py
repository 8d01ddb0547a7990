"""Quantisation with straight-through gradients (Voxel-GS).

    forward:  rint(x q) / q, ties to even;    backward:  d_x = d_rounded, so there is no kernel.

The integers are the source of truth of the bitstream; for |rint(x q)| < 2^22 they come back from
the dequantised values unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items, by_parts, filled

MOST_ARRAYS = 3
"""Arrays that a launch of :func:`forward` rounds, at most."""


def forward(device: Device, arrays: Sequence[tuple[DeviceArray, float]]) -> list[DeviceArray]:
    """rint(x q) / q in a new array for each (x, q), three at most, in one launch.

    x: float32, any shape; q: quantisation scale, positive.

    Raises:
        TypeError: an ``x`` is not float32.
    """
    for x, _ in arrays:
        _check(x)
    results = [device.empty(x.shape, np.float32) for x, _ in arrays]
    sizes, scales = np.zeros(4, np.uint32), np.ones(4, np.float32)
    for i, (x, q) in enumerate(arrays):
        sizes[i], scales[i] = x.size, q
    named: dict[str, DeviceArray] = {}
    pairs = [(x, rounded) for (x, _), rounded in zip(arrays, results, strict=True)]
    for i, (x, rounded) in enumerate(filled(pairs, MOST_ARRAYS)):
        named |= {f"x{i}": x, f"rounded{i}": rounded}
    kernel = device.kernel("anchors/quantize", "quantize_forward")
    device.run(kernel, *by_parts(sizes.tolist(), device.vec), **named, sizes=sizes, scales=scales)
    return results


def elements(device: Device, x: DeviceArray, q: DeviceArray) -> DeviceArray:
    """rint(x q) / q in a new float32 array, without -0; x and q > 0: float32, of one shape.

    Raises:
        TypeError, ValueError: a dtype is not float32, or the shapes differ.
    """
    _check(x)
    if q.shape != x.shape or q.dtype != np.float32:
        raise ValueError(f"q: {q.dtype}{q.shape}, expected float32{x.shape}")
    result = device.empty(x.shape, np.float32)
    device.run(
        device.kernel("anchors/quantize", "quantize_elements"),
        *by_items(-(-x.size // device.vec)),
        x=x,
        q=q,
        total=np.uint32(x.size),
        rounded=result,
    )
    return result


def integers(device: Device, x: DeviceArray, q: float) -> DeviceArray:
    """rint(x q) in a new int32 array of the shape of ``x``, float32."""
    _check(x)
    result = device.empty(x.shape, np.int32)
    device.run(
        device.kernel("anchors/quantize", "quantize_integers"),
        *by_items(-(-x.size // device.vec)),
        x=x,
        total=np.uint32(x.size),
        q=np.float32(q),
        integers=result,
    )
    return result


def _check(x: DeviceArray) -> None:
    if x.dtype != np.float32:
        raise TypeError(f"x: dtype is {x.dtype}, expected float32")
