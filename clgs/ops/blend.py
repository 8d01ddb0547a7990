"""Blend the Gaussians of every tile, front to back.

With the whitened offsets of ``clgs.ops.project``, of dx, dy from the Gaussian's centre to the
pixel's, and the list of the pixel's tile in order i:
    alpha_i = min(ALPHA_MAX, opacity_i exp(-(y1^2 + y2^2) / 2)), skipped if < ALPHA_CUT,
    image = sum_i color_i alpha_i T_i + T background,   T_{i+1} = T_i (1 - alpha_i);
a pixel is finished at the first i that brings T below TRANSMITTANCE_STOP, which is left out or,
with the inclusive stop of the accuracy presets, still blended.
Backward, with B_i the colour behind Gaussian i, relative to T_{i+1}, and both dotted with d_image:
    dL/d(alpha_i) = T_i (color_i - B_i),   B_{i-1} = B_i + alpha_i (color_i - B_i).
The geometric gradients are gathered as moments of v = alpha dL/d(alpha) in whitened coordinates:
one row per entry, summed for each Gaussian in a fixed order, so that runs agree bit for bit. An
alpha of ALPHA_MAX passes no gradient on to opacity or geometry.

Sources: 3DGS (Kerbl et al. 2023); the whitened moments are our own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import LaunchSizes, by_items, by_lanes
from clgs.opencl.kernel import Argument
from clgs.ops.project import Projected, ProjectedGradients
from clgs.ops.tiles import TileLists, tile_count
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes

RECORD_SIZE = 16
"""Floats of a Gaussian that is ready to blend."""

ROW_SIZE = 16
SUM_SIZE = 9
"""Floats of an entry's row of moments, and of a Gaussian's sums of them."""


@dataclass(frozen=True)
class Blended:
    """The picture, and what it was made from.

    image (3, H, W) and transmittance (H, W), float32; last_contributor (H, W) int32: number of
    entries of the pixel's list that it saw before it was finished, all if it never was; records:
    the Gaussian of every entry of ``tiles``, ready to blend; background (3,) float32.
    """

    image: DeviceArray
    transmittance: DeviceArray
    last_contributor: DeviceArray
    records: DeviceArray
    tiles: TileLists
    background: DeviceArray
    options: RenderOptions


def forward(
    device: Device,
    projected: Projected,
    tiles: TileLists,
    background: DeviceArray,
    options: RenderOptions = DEFAULT,
) -> Blended:
    """Render the Gaussians ``projected`` by their lists, which know the size of the image.

    Colors are clamped to +-1000, and a Gaussian with a NaN is not drawn. ``background``: (3,)
    float32.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(projected, tiles, background)
    width, height = tiles.size
    result = Blended(
        image=device.empty((3, height, width)),
        transmittance=device.empty((height, width)),
        last_contributor=device.empty((height, width), np.int32),
        records=gather(device, projected, tiles, options),
        tiles=tiles,
        background=background,
        options=options,
    )
    kernel = device.kernel("blend/forward", "blend_forward", **defines(device, options))
    device.run(kernel, *tile_grid(device, tiles), **forward_arguments(result))
    return result


def backward(
    device: Device, projected: Projected, blended: Blended, d_image: DeviceArray
) -> ProjectedGradients:
    """Gradients from that of the image, (3, H, W) float32, which :func:`forward` made.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(projected, blended.tiles, blended.background)
    rows, row_range = _rows(device, blended, d_image), blended.tiles.row_range
    summed = {"rows": rows, "row_range": row_range}
    return _gradients(device, "blend_sum", blended.options, projected, **summed)


def accumulate(device: Device, blended: Blended, d_image: DeviceArray, sums: DeviceArray) -> None:
    """Add what the entries of ``blended`` contribute to the gradients to ``sums``, (N, 9) float32.

    For pictures whose lists are made in parts: the sums start as zeros, lists of later tiles follow
    those of earlier ones, then :func:`finish` makes the gradients, the bits of :func:`backward`.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    row_range = blended.tiles.row_range
    count = len(row_range) - 1
    Shapes(N=count).check("sums", sums, f"N {SUM_SIZE}", np.float32)
    device.run(
        device.kernel("blend/sums", "blend_accumulate", **defines(device, blended.options)),
        *by_items(count),
        rows=_rows(device, blended, d_image),
        row_range=row_range,
        count=np.int32(count),
        sums=sums,
    )


def finish(
    device: Device,
    projected: Projected,
    sums: DeviceArray,
    options: RenderOptions = DEFAULT,
) -> ProjectedGradients:
    """Gradients from the sums that :func:`accumulate` made; other arguments as in :func:`forward`.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("opacity", projected.opacity, "N", np.float32)
    shapes.check("color", projected.color, "N 3", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("sums", sums, f"N {SUM_SIZE}", np.float32)
    return _gradients(device, "blend_finish", options, projected, sums=sums)


def _rows(device: Device, blended: Blended, d_image: DeviceArray) -> DeviceArray:
    """One row of moments per entry."""
    height, width = blended.transmittance.shape
    Shapes(H=height, W=width).check("d_image", d_image, "3 H W", np.float32)
    rows = device.empty((len(blended.tiles.gaussian), ROW_SIZE))
    kernel = device.kernel("blend/backward", "blend_backward", **defines(device, blended.options))
    grid = tile_grid(device, blended.tiles)
    device.run(kernel, *grid, **backward_arguments(blended, d_image, rows))
    return rows


def defines(device: Device, options: RenderOptions) -> dict[str, int | float]:
    """Build options of the kernels."""
    sizes = {"RECORD_SIZE": RECORD_SIZE, "ROW_SIZE": ROW_SIZE, "SUM_SIZE": SUM_SIZE}
    skips = options.skips.defines("units", "finished", "contributors", "empty_tiles")
    return {"VEC": device.lanes, **sizes, **options.accuracy.defines(), **skips}


def tile_grid(device: Device, tiles: TileLists) -> LaunchSizes:
    """One work-item per tile, or one work-group per tile with a work-item per pixel."""
    group = TILE_SIZE**2 if device.specialisation == "gpu" else 1
    return ((len(tiles.tile_range) - 1) * group,), (group,)


def gather(
    device: Device,
    projected: Projected,
    tiles: TileLists,
    options: RenderOptions = DEFAULT,
) -> DeviceArray:
    """Records of the entries of ``tiles``; arguments as in :func:`forward`."""
    count, macros = len(projected.opacity), defines(device, options)
    prepared = device.empty((count, RECORD_SIZE))
    records = device.empty((len(tiles.gaussian), RECORD_SIZE))
    device.run(
        device.kernel("blend/prepare", "blend_prepare", **macros),
        *by_lanes(device, count, device.lanes),
        mean2d=projected.mean2d,
        whitening=projected.whitening,
        color=projected.color,
        opacity=projected.opacity,
        count=np.int32(count),
        prepared=prepared,
    )
    device.run(
        device.kernel("blend/prepare", "blend_gather", **macros),
        *tile_grid(device, tiles),
        prepared=prepared,
        gaussian=tiles.gaussian,
        row=tiles.row,
        tile_range=tiles.tile_range,
        width=np.int32(tiles.size[0]),
        records=records,
    )
    return records


def forward_arguments(blended: Blended) -> dict[str, Argument]:
    """The arguments of blend_forward, which fills the last three."""
    height, width = blended.transmittance.shape
    return {
        "records": blended.records,
        "tile_range": blended.tiles.tile_range,
        "background": blended.background,
        "width": np.int32(width),
        "height": np.int32(height),
        "image": blended.image,
        "transmittance": blended.transmittance,
        "last_contributor": blended.last_contributor,
    }


def backward_arguments(
    blended: Blended, d_image: DeviceArray, rows: DeviceArray
) -> dict[str, Argument]:
    """The arguments of blend_backward, which fills ``rows``."""
    arguments = {**forward_arguments(blended), "d_image": d_image, "rows": rows}
    del arguments["image"]
    return arguments


def _gradients(
    device: Device,
    kernel: str,
    options: RenderOptions,
    projected: Projected,
    **summed: DeviceArray,
) -> ProjectedGradients:
    """Run blend_sum or blend_finish."""
    count = len(projected.opacity)
    result = ProjectedGradients(
        d_mean2d=device.empty((count, 2)),
        d_whitening=device.empty((count, 3)),
        d_color=device.empty((count, 3)),
        d_opacity=device.empty((count,)),
    )
    device.run(
        device.kernel("blend/sums", kernel, **defines(device, options)),
        *by_items(count),
        **summed,
        count=np.int32(count),
        whitening=projected.whitening,
        color=projected.color,
        opacity=projected.opacity,
        **vars(result),
    )
    return result


def _check(projected: Projected, tiles: TileLists, background: DeviceArray) -> None:
    shapes = Shapes(tiles_and_end=tile_count(*tiles.size) + 1)
    shapes.check("mean2d", projected.mean2d, "N 2", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("color", projected.color, "N 3", np.float32)
    shapes.check("opacity", projected.opacity, "N", np.float32)
    shapes.check("background", background, "3", np.float32)
    shapes.check("gaussian", tiles.gaussian, "I", np.int32)
    shapes.check("row", tiles.row, "I", np.int32)
    shapes.check("tile_range", tiles.tile_range, "tiles_and_end", np.int32)
    Shapes(rows_and_end=len(projected.opacity) + 1).check(
        "row_range", tiles.row_range, "rows_and_end", np.int32
    )
