"""Kernels that only the laboratory builds: what a device can do, and what stages decide.

Limits, against which stages are measured. copy: target = source. fma: CHAINS independent chains
x <- x factor + term per lane, starting at (1 .. CHAINS) / 8, and their sum. rounding: the
operations whose last bit drivers disagree about. Decisions, and numbers of pairs, come from
builds of the blending that say so, and from outputs of the MLPs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import HEAD_DIMS, K_OFFSETS, TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import ANY_GROUP, by_items
from clgs.opencl.kernel import Argument, Kernel
from clgs.ops import blend, mlp
from clgs.reference.blend import Decisions
from clgs.shapes import Shapes

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
        *by_items(-(-len(source) // device.vec)),
        source=source,
        total=np.uint32(len(source)),
        target=target,
    )


def fma(device: Device, groups: int, steps: int) -> DeviceArray:
    """The sums (lanes,) float32 of chains of ``steps`` fused multiply-adds, all lanes equal.

    ``groups`` work-groups run; lanes = groups * (1 or ANY_GROUP work-items) * vector lanes, and
    2 CHAINS steps lanes operations are made.
    """
    group = ANY_GROUP if device.specialisation == "gpu" else 1
    result = device.empty((groups * group * device.vec,))
    device.run(
        device.kernel("limits/limits", "limits_fma"),
        (groups * group,),
        (group,),
        factor=np.float32(FACTOR),
        term=np.float32(TERM),
        steps=np.int32(steps),
        result=result,
    )
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
    device.run(
        device.kernel("limits/limits", "limits_rounding"),
        *by_items(-(-len(x) // device.vec)),
        x=x,
        y=y,
        z=z,
        total=np.uint32(len(x)),
        rounded=result,
    )
    return result


def exact_rounding(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], z: npt.NDArray[np.float64]
) -> npt.NDArray[np.float32]:
    """What :func:`rounding` computes on a device that keeps to IEEE 754.

    The arguments hold numbers of float32 with magnitudes from 1 to 4: x y and x y + z are exact in
    float64 then, and a quotient or root that float64 has rounded rounds on as if it were exact.
    """
    product = (x * y).astype(np.float32).astype(np.float64)
    return np.stack([x / y, np.sqrt(y), product + z, x * y + z]).astype(np.float32)


def observed_passes(
    device: Device, blended: blend.Blended, d_image: DeviceArray, **observe: int
) -> Iterator[tuple[Kernel, dict[str, Argument]]]:
    """The forward and the backward kernel, built to be observed, with their usual arguments.

    ``observe``: a macro of kernels_cl/blend/observe.h, which adds arguments to the kernels.
    """
    macros = {**observe, **blend.defines(device, blended.options)}
    rows = device.empty((len(blended.tiles.gaussian), blend.ROW_SIZE))
    forward_kernel = device.kernel("blend/forward", "blend_forward", **macros)
    yield forward_kernel, blend.forward_arguments(blended)
    backward_kernel = device.kernel("blend/backward", "blend_backward", **macros)
    yield backward_kernel, blend.backward_arguments(blended, d_image, rows)


@dataclass(frozen=True)
class PairCounts:
    """Pairs of a pixel and a Gaussian, in one pass over a picture.

    visited: pairs that were computed; blended: those of them that changed a pixel.
    """

    visited: int
    blended: int


def count_pairs(
    device: Device, blended: blend.Blended, d_image: DeviceArray
) -> tuple[PairCounts, PairCounts]:
    """The work of the forward and of the backward kernel; renders once more."""
    grid = blend.tile_grid(device, blended.tiles)
    found = []
    for kernel, arguments in observed_passes(device, blended, d_image, COUNT_PAIRS=1):
        pairs = device.zeros((grid[0][0], 2), np.uint64)
        device.run(kernel, *grid, **arguments, pairs=pairs)
        visited, taken = device.download(pairs).sum(axis=0, dtype=np.uint64)
        found.append(PairCounts(int(visited), int(taken)))
    return found[0], found[1]


def blend_decisions(
    device: Device, blended: blend.Blended, d_image: DeviceArray
) -> tuple[Decisions, Decisions]:
    """What the forward and what the backward kernel decide; slow."""
    words = (len(blended.tiles.gaussian), TILE_SIZE**2 // 32)
    found = []
    for kernel, arguments in observed_passes(device, blended, d_image, EXPORT_DECISIONS=1):
        bits = {name: device.zeros(words, np.uint32) for name in ("blended", "clamped")}
        device.run(kernel, *blend.tile_grid(device, blended.tiles), **arguments, **bits)
        words_of = (device.download(one)[:, :, None] for one in bits.values())
        taken = (one >> np.arange(32, dtype=np.uint32) & np.uint32(1) for one in words_of)
        found.append(Decisions(*(one.reshape(-1, TILE_SIZE**2).astype(bool) for one in taken)))
    return found[0], found[1]


def drawn_rows(output: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Which outputs (110, V) of the MLPs are ever read: opacities, and the rows of drawn slots."""
    drawn = output[:K_OFFSETS] > 0
    color, covariance = (HEAD_DIMS[name] // K_OFFSETS for name in ("color", "covariance"))
    rows = [np.ones_like(drawn), np.repeat(drawn, color, 0), np.repeat(drawn, covariance, 0)]
    return np.concatenate(rows)


def drawn_output(device: Device, activations: mlp.Activations) -> npt.NDArray[np.float32]:
    """Host copy (110, V) of the MLPs' outputs, zero for those that are never read."""
    output = device.download(activations.output)[:, : len(activations.visible)]
    return np.where(drawn_rows(output), output, np.float32(0))
