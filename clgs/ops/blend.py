"""Blend the Gaussians of every tile, front to back.

With the whitened offsets of ``clgs.ops.project`` and the list of the pixel's tile in order i:
    alpha_i = min(ALPHA_MAX, opacity_i exp(-(y1^2 + y2^2) / 2)), skipped if < ALPHA_CUT,
    image = sum_i color_i alpha_i T_i + T background,   T_{i+1} = T_i (1 - alpha_i);
a pixel is finished at the first i that brings T below TRANSMITTANCE_STOP, which is left out or,
with the inclusive stop of the accuracy presets, still blended.
Backward, with B_i the colour after entry i relative to T_{i+1}, both dotted with d_image:
    dL/d(alpha_i) = T_i (color_i - B_i),   B_{i-1} = B_i + alpha_i (color_i - B_i).
The geometric gradients are gathered as moments of v = alpha dL/d(alpha) in whitened coordinates:
one row per entry, summed for each Gaussian in a fixed order, so that runs agree bit for bit.

Sources: 3DGS (Kerbl et al. 2023); the whitened moments are our own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.ops.project import Projected
from clgs.ops.tiles import TileLists, tile_count
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes

GROUP_SIZE = 64
RECORD_SIZE = 16
ROW_SIZE = 16
SUM_SIZE = 9


@dataclass(frozen=True)
class Blended:
    """The picture, and what the backward pass needs of the forward one.

    image (3, H, W) and transmittance (H, W), float32; last_contributor (H, W) int32: number of
    entries of the pixel's list that it saw before it was finished, all if it never was; records:
    the Gaussian of every entry, ready to blend; options: how it was made.
    """

    image: DeviceArray
    transmittance: DeviceArray
    last_contributor: DeviceArray
    records: DeviceArray
    options: RenderOptions


@dataclass(frozen=True)
class BlendGradients:
    """Gradients of the loss, float32; zero for Gaussians that touch nothing.

    d_mean2d (N, 2) per pixel, d_whitening (N, 3), d_color (N, 3), d_opacity (N,).
    """

    d_mean2d: DeviceArray
    d_whitening: DeviceArray
    d_color: DeviceArray
    d_opacity: DeviceArray


@dataclass(frozen=True)
class Decisions:
    """Per entry and pixel of its tile (row-major): bool (I, TILE_SIZE^2) on the host.

    contributed: the entry was blended into the pixel; saturated: with alpha at ALPHA_MAX.
    """

    contributed: npt.NDArray[np.bool_]
    saturated: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class PairCounts:
    """Pairs of a pixel and a record, in one pass over a picture.

    visited: computed, whether they touch or not; blended: those that changed a pixel.
    """

    visited: int
    blended: int


def forward(
    device: Device,
    projected: Projected,
    color: DeviceArray,
    opacity: DeviceArray,
    tiles: TileLists,
    background: DeviceArray,
    size: tuple[int, int],
    options: RenderOptions = DEFAULT,
) -> Blended:
    """Render an image.

    Args:
        device: where the arrays live.
        projected: N Gaussians on the screen.
        color: (N, 3) float32, clamped to +-1000; a Gaussian with a NaN is not drawn.
        opacity: (N,) float32.
        tiles: lists made for the same image size.
        background: (3,) float32.
        size: width and height of the image, pixels.
        options: accuracy and skips.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    width, height = _check(projected, color, opacity, tiles, background, size)
    result = Blended(
        image=device.empty((3, height, width)),
        transmittance=device.empty((height, width)),
        last_contributor=device.empty((height, width), np.int32),
        records=gather(device, projected, color, opacity, tiles, width, options),
        options=options,
    )
    kernel = device.kernel("blend/forward", "blend_forward", **_defines(device, options))
    device.run(kernel, *_grid(device, tiles), *_forward_arguments(result, tiles, background))
    return result


def backward(
    device: Device,
    projected: Projected,
    color: DeviceArray,
    opacity: DeviceArray,
    tiles: TileLists,
    background: DeviceArray,
    blended: Blended,
    d_image: DeviceArray,
) -> BlendGradients:
    """Gradients from that of the image, (3, H, W) float32; other arguments as in :func:`forward`.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    height, width = blended.transmittance.shape
    _check(projected, color, opacity, tiles, background, (width, height))
    rows = _rows(device, tiles, background, blended, d_image)
    summed = rows, tiles.row_range
    return _gradients(device, "blend_sum", blended.options, summed, projected, color, opacity)


def accumulate(
    device: Device,
    tiles: TileLists,
    background: DeviceArray,
    blended: Blended,
    d_image: DeviceArray,
    sums: DeviceArray,
) -> None:
    """Add what the entries of ``tiles`` contribute to the gradients to ``sums``, (N, 9) float32.

    For pictures whose lists are made in parts: the sums start as zeros, lists of later tiles follow
    those of earlier ones, then :func:`finish` makes the gradients, the bits of :func:`backward`.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = len(tiles.row_range) - 1
    Shapes(N=count).check("sums", sums, f"N {SUM_SIZE}", np.float32)
    rows = _rows(device, tiles, background, blended, d_image)
    kernel = device.kernel("blend/sums", "blend_accumulate", **_defines(device, blended.options))
    grid = (round_up(count, GROUP_SIZE),), (GROUP_SIZE,)
    device.run(kernel, *grid, rows, tiles.row_range, np.int32(count), sums)


def finish(
    device: Device,
    projected: Projected,
    color: DeviceArray,
    opacity: DeviceArray,
    sums: DeviceArray,
    options: RenderOptions = DEFAULT,
) -> BlendGradients:
    """Gradients from the sums that :func:`accumulate` made; other arguments as in :func:`forward`.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("opacity", opacity, "N", np.float32)
    shapes.check("color", color, "N 3", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("sums", sums, f"N {SUM_SIZE}", np.float32)
    return _gradients(device, "blend_finish", options, (sums,), projected, color, opacity)


def _rows(
    device: Device,
    tiles: TileLists,
    background: DeviceArray,
    blended: Blended,
    d_image: DeviceArray,
) -> DeviceArray:
    """One row of moments per entry."""
    height, width = blended.transmittance.shape
    Shapes(H=height, W=width).check("d_image", d_image, "3 H W", np.float32)
    rows = device.empty((len(tiles.gaussian), ROW_SIZE))
    kernel = device.kernel("blend/backward", "blend_backward", **_defines(device, blended.options))
    arguments = _backward_arguments(blended, tiles, background, d_image)
    device.run(kernel, *_grid(device, tiles), *arguments, rows)
    return rows


def decisions(
    device: Device,
    tiles: TileLists,
    background: DeviceArray,
    blended: Blended,
    d_image: DeviceArray,
) -> tuple[Decisions, Decisions]:
    """What the forward and what the backward kernel decide; slow, for tests.

    Both are compiled from the same source as ever, with EXPORT_DECISIONS.
    """
    words = (len(tiles.gaussian), TILE_SIZE**2 // 32)
    found = []
    for kernel, arguments in _passes(
        device, tiles, background, blended, d_image, EXPORT_DECISIONS=1
    ):
        bits = [device.zeros(words, np.uint32) for _ in range(2)]
        device.run(kernel, *_grid(device, tiles), *arguments, *bits)
        found.append(Decisions(*(_unpack(device.download(one)) for one in bits)))
    return found[0], found[1]


def count_pairs(
    device: Device,
    tiles: TileLists,
    background: DeviceArray,
    blended: Blended,
    d_image: DeviceArray,
) -> tuple[PairCounts, PairCounts]:
    """The work of the forward and of the backward kernel; renders once more.

    Both are compiled from the same source as ever, with COUNT_PAIRS.
    """
    grid = _grid(device, tiles)
    found = []
    for kernel, arguments in _passes(device, tiles, background, blended, d_image, COUNT_PAIRS=1):
        pairs = device.zeros((grid[0][0], 2), np.uint64)
        device.run(kernel, *grid, *arguments, pairs)
        visited, taken = device.download(pairs).sum(axis=0, dtype=np.uint64)
        found.append(PairCounts(int(visited), int(taken)))
    return found[0], found[1]


def _passes(
    device: Device,
    tiles: TileLists,
    background: DeviceArray,
    blended: Blended,
    d_image: DeviceArray,
    **observe: int,
) -> Iterator[tuple[Any, tuple[DeviceArray | np.int32, ...]]]:
    """The forward and the backward kernel, built to be observed, with their usual arguments."""
    defines = {**observe, **_defines(device, blended.options)}
    rows = device.empty((len(tiles.gaussian), ROW_SIZE))
    forward_arguments = _forward_arguments(blended, tiles, background)
    backward_arguments = (*_backward_arguments(blended, tiles, background, d_image), rows)
    yield device.kernel("blend/forward", "blend_forward", **defines), forward_arguments
    yield device.kernel("blend/backward", "blend_backward", **defines), backward_arguments


def _unpack(words: npt.NDArray[np.uint32]) -> npt.NDArray[np.bool_]:
    bits = words[:, :, None] >> np.arange(32, dtype=np.uint32) & np.uint32(1)
    return bits.reshape(len(words), TILE_SIZE**2).astype(bool)


def _defines(device: Device, options: RenderOptions) -> dict[str, int | float]:
    skips = options.skips.defines("units", "finished", "contributors", "empty_tiles")
    return {"VEC": device.lanes, **options.accuracy.defines(), **skips}


def _grid(device: Device, tiles: TileLists) -> tuple[tuple[int], tuple[int]]:
    """One work-item per tile, or one work-group per tile with one work-item per pixel."""
    group = TILE_SIZE**2 if device.specialisation == "gpu" else 1
    return ((len(tiles.tile_range) - 1) * group,), (group,)


def gather(
    device: Device,
    projected: Projected,
    color: DeviceArray,
    opacity: DeviceArray,
    tiles: TileLists,
    width: int,
    options: RenderOptions = DEFAULT,
) -> DeviceArray:
    """Records of the entries of ``tiles``; ``width`` of the image, others as in :func:`forward`."""
    count, defines = len(opacity), _defines(device, options)
    prepared = device.empty((count, RECORD_SIZE))
    records = device.empty((len(tiles.gaussian), RECORD_SIZE))
    device.run(
        device.kernel("blend/prepare", "blend_prepare", **defines),
        (round_up(-(-count // device.lanes), GROUP_SIZE),),
        (GROUP_SIZE,),
        projected.mean2d,
        projected.whitening,
        color,
        opacity,
        np.int32(count),
        prepared,
    )
    lists = tiles.gaussian, tiles.row, tiles.tile_range
    gather = device.kernel("blend/prepare", "blend_gather", **defines)
    device.run(gather, *_grid(device, tiles), prepared, *lists, np.int32(width), records)
    return records


def _forward_arguments(
    blended: Blended, tiles: TileLists, background: DeviceArray
) -> tuple[DeviceArray | np.int32, ...]:
    height, width = blended.transmittance.shape
    read = blended.records, tiles.tile_range, background, np.int32(width), np.int32(height)
    return *read, blended.image, blended.transmittance, blended.last_contributor


def _backward_arguments(
    blended: Blended, tiles: TileLists, background: DeviceArray, d_image: DeviceArray
) -> tuple[DeviceArray | np.int32, ...]:
    height, width = blended.transmittance.shape
    read = blended.records, tiles.tile_range, background, np.int32(width), np.int32(height)
    return *read, blended.transmittance, blended.last_contributor, d_image


def _gradients(
    device: Device,
    kernel: str,
    options: RenderOptions,
    summed: tuple[DeviceArray, ...],
    projected: Projected,
    color: DeviceArray,
    opacity: DeviceArray,
) -> BlendGradients:
    """Run blend_sum or blend_finish."""
    count = len(opacity)
    result = BlendGradients(
        d_mean2d=device.empty((count, 2)),
        d_whitening=device.empty((count, 3)),
        d_color=device.empty((count, 3)),
        d_opacity=device.empty((count,)),
    )
    device.run(
        device.kernel("blend/sums", kernel, **_defines(device, options)),
        (round_up(count, GROUP_SIZE),),
        (GROUP_SIZE,),
        *summed,
        np.int32(count),
        projected.whitening,
        color,
        opacity,
        result.d_mean2d,
        result.d_whitening,
        result.d_color,
        result.d_opacity,
    )
    return result


def _check(
    projected: Projected,
    color: DeviceArray,
    opacity: DeviceArray,
    tiles: TileLists,
    background: DeviceArray,
    size: tuple[int, int],
) -> tuple[int, int]:
    shapes = Shapes(tiles_and_end=tile_count(*size) + 1)
    shapes.check("mean2d", projected.mean2d, "N 2", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("color", color, "N 3", np.float32)
    shapes.check("opacity", opacity, "N", np.float32)
    shapes.check("background", background, "3", np.float32)
    shapes.check("gaussian", tiles.gaussian, "I", np.int32)
    shapes.check("row", tiles.row, "I", np.int32)
    shapes.check("tile_range", tiles.tile_range, "tiles_and_end", np.int32)
    Shapes(rows_and_end=len(opacity) + 1).check(
        "row_range", tiles.row_range, "rows_and_end", np.int32
    )
    return size
