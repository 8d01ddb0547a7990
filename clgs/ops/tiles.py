"""Per-tile lists of the Gaussians that may touch a tile, front to back.

A Gaussian is listed for a tile if the smallest y1^2 + y2^2 over the rectangle of its pixel centres
allows alpha >= ALPHA_CUT, with a slack for rounding, so that the rendered image is bit-identical to
one made from lists that hold every Gaussian in every tile. The part of an ellipse between the first
and the last pixel row of a row of tiles is convex, so that it reaches neighbouring tiles: a span,
found from its first and its last column without a test of each tile. Gaussians are sorted by depth
once (ties by index), then one stable pass by tile finishes the lists; on a CPU it has two steps, of
the spans by row of tiles, and of the tiles of each row by column.

Sources: 3DGS (tiles of 16x16, ascending depth); exact lists as in Speedy-Splat and StopThePop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.opencl.grid import by_items, chunk_count
from clgs.opencl.kernel import Argument
from clgs.ops import scan, sort
from clgs.ops.project import Projected
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes

ROW_CHUNKS = 64
"""Work-items that count entries by row of tiles."""
SPARE = 4
"""Spare slots of a chunk for unused spans, after all others; on a CPU."""


@dataclass(frozen=True)
class TileLists:
    """I entries in T tiles (row-major), int32; a list is in ascending depth, ties by index.

    size: width and height of the image, pixels; gaussian (I,): index of the Gaussian of each entry,
    in (tile, depth) order; row (I,): a number of its own for each entry, by Gaussian, then tile;
    tile_range (T + 1,): the entries of tile t are [tile_range[t], tile_range[t + 1]); row_range
    (N + 1,): the rows of Gaussian n are [row_range[n], row_range[n + 1]); total (1,) int64: number
    of entries that were found. Lists made in a smaller room are empty; in a larger one, the entries
    after the last tile's are padding.
    """

    size: tuple[int, int]
    gaussian: DeviceArray
    row: DeviceArray
    tile_range: DeviceArray
    row_range: DeviceArray
    total: DeviceArray


def tile_count(width: int, height: int) -> int:
    """T: number of tiles that cover an image."""
    return -(-width // TILE_SIZE) * -(-height // TILE_SIZE)


@dataclass(frozen=True)
class _Footprints:
    """The tiles of N Gaussians, and all that finds them again.

    geometry: arguments of kernels that find tiles; size: of the image; boxes (N, 4) int32; counts
    (N,) int32; parts: sums of the counts.
    """

    geometry: dict[str, Argument]
    size: tuple[int, int]
    defines: dict[str, int | float]
    boxes: DeviceArray
    counts: DeviceArray
    parts: scan.PartSums

    @property
    def columns(self) -> int:
        """Tiles in a row."""
        return tile_count(self.size[0], 1)

    @property
    def tiles(self) -> int:
        """T."""
        return tile_count(*self.size)


def forward(
    device: Device,
    projected: Projected,
    size: tuple[int, int],
    options: RenderOptions = DEFAULT,
    room: int = scan.EXACT,
    tile_rows: tuple[int, int] | None = None,
) -> TileLists:
    """Build the lists.

    Args:
        device: where the arrays live.
        projected: N Gaussians on the screen; drawn if extent > 0.
        size: width and height of the image, pixels.
        options: accuracy, for the alpha cut; skips, for the exact test.
        room: I; EXACT waits once for the device to learn the number of entries.
        tile_rows: first and end of the rows of tiles that are filled; default all.

    Raises:
        ClgsError: the room is EXACT, and there would be more than 2^31 - 1 entries.
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(projected)
    found = _footprints(device, projected, size, tile_rows or (0, tile_count(1, size[1])), options)
    keys = projected.depth.of_type(np.uint32)  # the bits of positive floats keep their order
    order = sort.chosen(device, keys, found.counts)
    rows = scan.on_device(device, found.counts, min(room, scan.MAX_TOTAL), found.parts)
    finish = _sort_entries if device.specialisation == "gpu" else _count_entries
    return finish(device, found, order, rows, room)


def count_by_row(
    device: Device,
    projected: Projected,
    size: tuple[int, int],
    options: RenderOptions = DEFAULT,
) -> npt.NDArray[np.int64]:
    """Entries that the lists of every row of tiles would have, from the top; waits for the device.

    Arguments as in :func:`forward`. The counts are of 64 bits: no list is made of them.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(projected)
    rows = tile_count(1, size[1])
    found = _footprints(device, projected, size, (0, rows), options)
    reached = device.empty((ROW_CHUNKS, rows), np.int64)
    device.run(
        device.kernel("tiles/by_row", "tiles_by_row", **found.defines),
        *((ROW_CHUNKS,), (1,)),
        **found.geometry,
        count=np.int32(len(found.counts)),
        boxes=found.boxes,
        counts=found.counts,
        rows=np.int32(rows),
        reached=reached,
    )
    return np.asarray(device.download(reached).sum(axis=0))


def _footprints(
    device: Device,
    projected: Projected,
    size: tuple[int, int],
    tile_rows: tuple[int, int],
    options: RenderOptions,
) -> _Footprints:
    count = len(projected.opacity)
    found = _Footprints(
        geometry={
            "mean2d": projected.mean2d,
            "whitening": projected.whitening,
            "opacity": projected.opacity,
            "extent": projected.extent,
            "width": np.int32(size[0]),
            "height": np.int32(size[1]),
            "first_row": np.int32(tile_rows[0]),
            "end_row": np.int32(tile_rows[1]),
        },
        size=size,
        defines={
            "VEC": device.lanes,
            "SPARE": SPARE,
            **options.accuracy.defines(),
            **options.skips.defines("exact_tiles"),
        },
        boxes=device.empty((count, 4), np.int32),
        counts=device.empty((count,), np.int32),
        parts=scan.parts_of(device, count, device.lanes),
    )
    device.run(
        device.kernel("tiles/footprint", "tiles_footprint", **found.defines),
        *scan.counting_grid(device, count, device.lanes),
        **found.geometry,
        count=np.int32(count),
        boxes=found.boxes,
        counts=found.counts,
        sums=found.parts.sum,
    )
    return found


def _count_entries(
    device: Device,
    found: _Footprints,
    order: sort.Order,
    rows: scan.Offsets,
    room: int,
) -> TileLists:
    """Two stable passes: by row of tiles, then by column within each."""
    chunks, count_of_rows = chunk_count(device), found.tiles // found.columns
    pitch = np.int32(round_up(count_of_rows + 1, 8))
    counters = device.empty((chunks, int(pitch), 2), np.int32)
    ranked = device.empty(found.boxes.shape, np.int32)
    ordered = {**found.geometry, "order": order.index, "ordered": order.count}

    def run(name: str, items: int, /, **arguments: Argument) -> None:
        kernel = device.kernel("tiles/lists", name, **found.defines)
        device.run(kernel, (items,), (1,), **arguments)

    run(
        "tiles_count",
        chunks,
        **ordered,
        boxes=found.boxes,
        row_range=rows.offset,
        pitch=pitch,
        ranked=ranked,
        counters=counters,
    )
    entries = scan.room_for(device, rows, room)
    limit: dict[str, Argument] = {"total": rows.total, "capacity": np.int32(entries)}
    starts = device.empty((count_of_rows + 1, 2), np.int32)
    run(
        "tiles_starts",
        1,
        counters=counters,
        chunks=np.int32(chunks),
        pitch=pitch,
        rows=np.int32(count_of_rows),
        **limit,
        starts=starts,
    )
    spans = device.empty((entries + SPARE * chunks, 4), np.int32)
    run(
        "tiles_place",
        chunks,
        **ordered,
        ranked=ranked,
        pitch=pitch,
        **limit,
        places=counters,
        spans=spans,
    )
    tile_range = device.empty((found.tiles + 1,), np.int32)
    gaussian, row = (device.empty((entries,), np.int32) for _ in range(2))
    pitch = np.int32(round_up(found.columns + 1, 16))
    run(
        "tiles_enter",
        count_of_rows,
        spans=spans,
        starts=starts,
        columns=np.int32(found.columns),
        rows=np.int32(count_of_rows),
        pitch=pitch,
        places=device.empty((count_of_rows, int(pitch)), np.int32),
        tile_range=tile_range,
        gaussian=gaussian,
        row=row,
    )
    if room != scan.EXACT:
        run("tiles_pad_lists", chunks, **limit, gaussian=gaussian, row=row)
    return TileLists(found.size, gaussian, row, tile_range, rows.offset, rows.total)


def _sort_entries(
    device: Device,
    found: _Footprints,
    order: sort.Order,
    rows: scan.Offsets,
    room: int,
) -> TileLists:
    """Write the entries in depth order, then sort them by tile."""
    count, tiles = len(found.counts), found.tiles
    ordered = {"order": order.index, "ordered": order.count}
    ranked_counts, parts = device.empty((count,), np.int32), scan.parts_of(device, count, 1)
    device.run(
        device.kernel("tiles/lists", "tiles_rank", **found.defines),
        *scan.counting_grid(device, count, 1),
        **ordered,
        counts=found.counts,
        count=np.int32(count),
        ranked_counts=ranked_counts,
        sums=parts.sum,
    )
    places = scan.on_device(device, ranked_counts, parts=parts)
    entries = scan.room_for(device, rows, room)
    tile, row, owner = (device.empty((entries,), t) for t in (np.uint32, np.int32, np.int32))
    device.run(
        device.kernel("tiles/lists", "tiles_emit", **found.defines),
        *by_items(max(count, entries)),
        **found.geometry,
        **ordered,
        boxes=found.boxes,
        place=places.offset,
        row_range=rows.offset,
        total=rows.total,
        capacity=np.int32(entries),
        padding_tile=np.int32(tiles),
        tile=tile,
        row=row,
        gaussian_of_row=owner,
    )
    tile, row = sort.by_key(device, tile, row, tiles.bit_length())
    gaussian = device.empty((entries,), np.int32)
    tile_range = device.empty((tiles + 1,), np.int32)
    device.run(
        device.kernel("tiles/lists", "tiles_ranges", **found.defines),
        *by_items(entries + 1),
        tile=tile,
        row=row,
        entries=np.int32(entries),
        tiles=np.int32(tiles),
        gaussian_of_row=owner,
        tile_range=tile_range,
        gaussian=gaussian,
    )
    return TileLists(found.size, gaussian, row, tile_range, rows.offset, rows.total)


def _check(projected: Projected) -> None:
    shapes = Shapes()
    shapes.check("opacity", projected.opacity, "N", np.float32)
    shapes.check("mean2d", projected.mean2d, "N 2", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("depth", projected.depth, "N", np.float32)
    shapes.check("extent", projected.extent, "N 2", np.float32)
