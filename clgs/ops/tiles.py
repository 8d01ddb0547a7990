"""Per-tile lists of the Gaussians that may touch a tile, front to back.

A Gaussian is listed where the smallest y1^2 + y2^2 over the pixel centres of the tile allows
alpha >= ALPHA_CUT: an exact ellipse-rectangle test with a slack for rounding, so that the rendered
image is bit-identical to one made from lists that hold every Gaussian in every tile. Gaussians are
sorted by depth once (ties by index), emit their tiles in that order, and one stable sort by tile
number finishes the lists.

Sources: 3DGS (tiles of 16x16, ascending depth); the exact test as in Speedy-Splat and StopThePop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.constants import TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.ops import scan, sort
from clgs.ops.project import Projected
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes

GROUP_SIZE = 64
FOOTPRINT_SIZE = 8


@dataclass(frozen=True)
class TileLists:
    """I entries in T tiles (row-major), int32; a list is in ascending depth, ties by index.

    gaussian (I,): index of the Gaussian of each entry, in (tile, depth) order; row (I,): a number
    of its own for each entry, by Gaussian, then tile; tile_range (T + 1,): the entries of tile t
    are [tile_range[t], tile_range[t + 1]); row_range (N + 1,): the rows of Gaussian n are
    [row_range[n], row_range[n + 1]).
    """

    gaussian: DeviceArray
    row: DeviceArray
    tile_range: DeviceArray
    row_range: DeviceArray


def tile_count(width: int, height: int) -> int:
    """T: number of tiles that cover an image."""
    return -(-width // TILE_SIZE) * -(-height // TILE_SIZE)


def forward(
    device: Device,
    projected: Projected,
    opacity: DeviceArray,
    width: int,
    height: int,
    options: RenderOptions = DEFAULT,
) -> TileLists:
    """Build the lists; waits once for the device, to learn the number of entries.

    Args:
        device: where the arrays live.
        projected: N Gaussians on the screen; drawn where extent > 0.
        opacity: (N,) float32.
        width: of the image, pixels.
        height: of the image, pixels.
        options: accuracy, for the alpha cut.

    Raises:
        ClgsError: there would be more than 2^31 - 1 entries.
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(projected, opacity)
    size = np.int32(count), np.int32(width), np.int32(height)
    grid = (round_up(count, GROUP_SIZE),), (GROUP_SIZE,)
    footprints, ranked_footprints = (device.empty((count, FOOTPRINT_SIZE)) for _ in range(2))
    counts, ranked_counts = (device.empty((count,), np.int32) for _ in range(2))
    geometry = projected.mean2d, projected.whitening, opacity, projected.extent
    footprint = device.kernel("tiles", "tiles_footprint", **options.accuracy.defines())
    device.run(footprint, *grid, *geometry, *size, footprints)
    device.run(device.kernel("tiles", "tiles_count"), *grid, footprints, *size, counts)
    order = _by_depth(device, projected)
    by_gaussian, by_rank = (counts, footprints), (ranked_counts, ranked_footprints)
    tiles_rank = device.kernel("tiles", "tiles_rank")
    device.run(tiles_rank, *grid, order, *by_gaussian, size[0], *by_rank)
    rows, places = scan.on_device(device, counts), scan.on_device(device, ranked_counts)
    entries = scan.checked_total(device, rows)
    tile, row, gaussian_of_row = (
        device.empty((entries,), dtype) for dtype in (np.uint32, np.int32, np.int32)
    )
    emit = device.kernel("tiles", "tiles_emit")
    emitted = places.offset, rows.offset, tile, row, gaussian_of_row
    device.run(emit, *grid, order, ranked_footprints, *size, *emitted)
    tiles = tile_count(width, height)
    tile, row = sort.by_key(device, tile, row, max(tiles - 1, 0).bit_length())
    return _ranges(device, tile, row, gaussian_of_row, tiles, rows.offset)


def _ranges(
    device: Device,
    tile: DeviceArray,
    row: DeviceArray,
    gaussian_of_row: DeviceArray,
    tiles: int,
    row_range: DeviceArray,
) -> TileLists:
    """The lists from entries that are sorted by tile."""
    entries = len(row)
    lists = TileLists(
        gaussian=device.empty((entries,), np.int32),
        row=row,
        tile_range=device.empty((tiles + 1,), np.int32),
        row_range=row_range,
    )
    device.run(
        device.kernel("tiles", "tiles_ranges"),
        (round_up(entries + 1, GROUP_SIZE),),
        (GROUP_SIZE,),
        tile,
        row,
        np.int32(entries),
        np.int32(tiles),
        gaussian_of_row,
        lists.tile_range,
        lists.gaussian,
    )
    return lists


def _by_depth(device: Device, projected: Projected) -> DeviceArray:
    count = len(projected.depth)
    keys, index = device.empty((count,), np.uint32), device.empty((count,), np.int32)
    device.run(
        device.kernel("tiles", "tiles_keys"),
        (round_up(count, GROUP_SIZE),),
        (GROUP_SIZE,),
        projected.depth,
        projected.extent,
        np.int32(count),
        keys,
        index,
    )
    return sort.by_key(device, keys, index)[1]


def _check(projected: Projected, opacity: DeviceArray) -> int:
    shapes = Shapes()
    shapes.check("opacity", opacity, "N", np.float32)
    shapes.check("mean2d", projected.mean2d, "N 2", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("depth", projected.depth, "N", np.float32)
    shapes.check("extent", projected.extent, "N 2", np.float32)
    return shapes.axes["N"]
