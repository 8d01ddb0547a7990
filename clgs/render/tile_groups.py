"""Draw a view in groups of rows of tiles, so that what is stored per entry keeps to a budget.

Of each group only the picture, the transmittance and the last contributors are kept. The backward
pass makes the group's lists again and adds its rows of gradients to sums per Gaussian. A Gaussian's
rows are in the order of its tiles, and so are the groups: the sums have the bits of those over one
long list. The lists of all groups have the same length, so that each group takes the memory of the
one before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.errors import BudgetError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, scan, tiles
from clgs.ops.project import Projected, ProjectedGradients
from clgs.options import RenderOptions
from clgs.render.frame import DeviceView, TileGroups

LIST_BYTES = {"cpu": 24, "gpu": 36}
"""Bytes that an entry takes in the lists and while they are sorted."""
BYTES_BY_ENTRY = 4 * (blend.RECORD_SIZE + blend.ROW_SIZE)
"""Bytes of an entry's record and of its row of gradients."""


def within_budget(
    device: Device, projected: Projected, size: tuple[int, int], options: RenderOptions
) -> TileGroups | None:
    """The fewest groups that keep to ``options.max_memory`` bytes; None if one is enough.

    Waits for the device.

    Raises:
        BudgetError: a single row of tiles needs more.
    """
    assert options.max_memory is not None
    by_row = tiles.count_by_row(device, projected, size, options)
    entry_bytes = LIST_BYTES[device.specialisation] + BYTES_BY_ENTRY
    groups = split(by_row, entry_bytes, options.max_memory)
    return groups if len(groups.rows) > 1 else None


def split(by_row: npt.NDArray[np.int64], entry_bytes: int, max_memory: int) -> TileGroups:
    """The fewest groups of neighbouring rows of tiles of at most ``max_memory`` bytes each.

    ``by_row`` (rows,): entries of every row of tiles, which take ``entry_bytes`` each. Lists are at
    most 2^31 - 1 entries long in any case.

    Raises:
        BudgetError: a single row of tiles needs more.
    """
    most = min(max_memory // entry_bytes, scan.MAX_TOTAL)
    if len(by_row) and int(by_row.max()) > most:
        needed, given = int(by_row.max()) * entry_bytes, most * entry_bytes
        above, below = math.ceil(needed / 2**20 * 100) / 100, math.floor(given / 2**20 * 100) / 100
        raise BudgetError(
            f"a row of tiles needs {above:.2f} MiB, {below:.2f} MiB are allowed; "
            "raise --max-memory, or use a smaller image or fewer Gaussians",
            needed,
        )
    cuts, held, longest = [0], 0, 0
    for row, count in enumerate(by_row.tolist()):
        if held + count > most:
            cuts.append(row)
            held = 0
        held += count
        longest = max(longest, held)
    rows = tuple(zip(cuts, [*cuts[1:], len(by_row)], strict=True))
    return TileGroups(rows, longest, int(by_row.sum()))


def draw(
    device: Device,
    count: int,
    view: DeviceView,
    options: RenderOptions,
    groups: TileGroups,
    draw_rows: Callable[[int, tuple[int, int]], blend.Blended],
) -> blend.Blended:
    """The picture of ``count`` Gaussians in groups; its lists and records hold no entries.

    ``draw_rows`` draws rows of tiles, from the first to the end, with lists of the length given.
    """
    width, height = view.size
    lists = tiles.TileLists(
        size=view.size,
        gaussian=device.empty((0,), np.int32),
        row=device.empty((0,), np.int32),
        tile_range=device.zeros((tiles.tile_count(*view.size) + 1,), np.int32),
        row_range=device.zeros((count + 1,), np.int32),
        total=device.upload(np.array([groups.total], np.int64)),
    )
    whole = blend.Blended(
        image=device.empty((3, height, width)),
        transmittance=device.empty((height, width)),
        last_contributor=device.empty((height, width), np.int32),
        records=device.empty((0, blend.RECORD_SIZE)),
        tiles=lists,
        background=view.background,
        options=options,
    )
    for rows in groups.rows:
        _copy_rows(device, draw_rows(groups.longest, rows), whole, rows)
    return whole


def _copy_rows(
    device: Device, part: blend.Blended, whole: blend.Blended, rows: tuple[int, int]
) -> None:
    """Copy the pixels of the rows of tiles from the first to the end; ``part`` may go then."""
    width, height = whole.tiles.size
    first, end = (min(row * TILE_SIZE, height) * width for row in rows)
    for channel in range(3):
        start = channel * width * height + first
        device.copy_part(part.image, whole.image, start, end - first)
    device.copy_part(part.transmittance, whole.transmittance, first, end - first)
    device.copy_part(part.last_contributor, whole.last_contributor, first, end - first)


def backward(
    device: Device,
    projected: Projected,
    blended: blend.Blended,
    d_image: DeviceArray,
    groups: TileGroups,
) -> ProjectedGradients:
    """The gradients that ``blend.backward`` gives for one long list."""
    size, options = blended.tiles.size, blended.options
    sums = device.zeros((len(projected.opacity), blend.SUM_SIZE))
    for rows in groups.rows:
        lists = tiles.forward(device, projected, size, options, groups.longest, rows)
        records = blend.gather(device, projected, lists, options)
        blend.accumulate(device, replace(blended, tiles=lists, records=records), d_image, sums)
    return blend.finish(device, projected, sums, options)
