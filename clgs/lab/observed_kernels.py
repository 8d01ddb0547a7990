"""What kernels decide and how much they compute: from builds that say so, or counted from outputs.

The blending is compiled from the same source as ever, with a macro that adds arguments to its
kernels (kernels_cl/blend/observe.h).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import HEAD_DIMS, K_OFFSETS, OUTPUT_DIM, TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, mlp
from clgs.reference.blend import Decisions


@dataclass(frozen=True)
class PairCounts:
    """Pairs of a pixel and a Gaussian, in one pass over a picture.

    visited: pairs that were computed; blended: those of them that changed a pixel.
    """

    visited: int
    blended: int


def blend_decisions(
    device: Device, blended: blend.Blended, d_image: DeviceArray
) -> tuple[Decisions, Decisions]:
    """What the forward and what the backward kernel decide; slow."""
    words = (len(blended.tiles.gaussian), TILE_SIZE**2 // 32)
    found = []
    for kernel, arguments in _passes(device, blended, d_image, EXPORT_DECISIONS=1):
        bits = {name: device.zeros(words, np.uint32) for name in ("blended", "clamped")}
        device.run(kernel, *blend.tile_grid(device, blended.tiles), **arguments, **bits)
        found.append(Decisions(*(_unpack(device.download(one)) for one in bits.values())))
    return found[0], found[1]


def count_pairs(
    device: Device, blended: blend.Blended, d_image: DeviceArray
) -> tuple[PairCounts, PairCounts]:
    """The work of the forward and of the backward kernel; renders once more."""
    grid = blend.tile_grid(device, blended.tiles)
    found = []
    for kernel, arguments in _passes(device, blended, d_image, COUNT_PAIRS=1):
        pairs = device.zeros((grid[0][0], 2), np.uint64)
        device.run(kernel, *grid, **arguments, pairs=pairs)
        visited, taken = device.download(pairs).sum(axis=0, dtype=np.uint64)
        found.append(PairCounts(int(visited), int(taken)))
    return found[0], found[1]


def _passes(
    device: Device, blended: blend.Blended, d_image: DeviceArray, **observe: int
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The forward and the backward kernel, built to be observed, with their usual arguments."""
    macros = {**observe, **blend.defines(device, blended.options)}
    rows = device.empty((len(blended.tiles.gaussian), blend.ROW_SIZE))
    forward = device.kernel("blend/forward", "blend_forward", **macros)
    yield forward, blend.forward_arguments(blended)
    backward = device.kernel("blend/backward", "blend_backward", **macros)
    yield backward, blend.backward_arguments(blended, d_image, rows)


def _unpack(words: npt.NDArray[np.uint32]) -> npt.NDArray[np.bool_]:
    bits = words[:, :, None] >> np.arange(32, dtype=np.uint32) & np.uint32(1)
    return bits.reshape(len(words), TILE_SIZE**2).astype(bool)


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


@dataclass(frozen=True)
class MlpWork:
    """Samples, and rows of outputs times samples, that were computed, and how many there are."""

    samples: int
    all_samples: int
    rows: int
    all_rows: int


def mlp_work(device: Device, activations: mlp.Activations) -> MlpWork:
    """Count the samples whose colors and covariances were computed, and the rows of these heads.

    Waits for the device. Columns without an anchor are not counted.
    """
    count = int(np.count_nonzero(device.download(activations.visible) >= 0))
    drawn = device.download(activations.output)[:K_OFFSETS] > 0
    macros = mlp.defines(device, activations.options)
    block = int(macros["VECTORS"] * macros["VEC"])
    size = mlp.SAMPLES if device.specialisation == "gpu" else block
    drawn = np.pad(drawn, ((0, 0), (0, -drawn.shape[1] % size)))
    slots = np.any(drawn.reshape(K_OFFSETS, -1, size), axis=2)
    used = np.any(slots, axis=0)
    skips = activations.options.skips
    if not skips.slots:
        slots[:] = used | (not skips.opacity_first)
    if not skips.opacity_first:
        used[:] = True
    lanes = np.clip(count - size * np.arange(len(used)), 0, size)
    each = (OUTPUT_DIM - K_OFFSETS) // K_OFFSETS
    return MlpWork(
        samples=int(used @ lanes),
        all_samples=count,
        rows=each * int((slots @ lanes).sum()),
        all_rows=each * K_OFFSETS * count,
    )
