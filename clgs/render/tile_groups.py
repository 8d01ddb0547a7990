"""Draw a view in groups of rows of tiles, so that what is stored per entry keeps to a budget.

Of a group, only the picture, the transmittance and the last contributors are kept. The backward
pass makes its lists again and adds its rows of gradients to sums by Gaussian. A Gaussian's rows are
in the order of its tiles, and so are the groups: the sums have the bits of those over one long
list. All groups have lists of the same length, so that the next one takes the memory of the last.
"""

from __future__ import annotations

import math
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
from clgs.render.frame import DeviceView, Groups

LIST_BYTES = {"cpu": 24, "gpu": 36}
"""An entry of the lists, with what sorts it."""
BYTES_BY_ENTRY = 4 * (blend.RECORD_SIZE + blend.ROW_SIZE)
"""Its record and its row of gradients."""


def plan(by_row: npt.NDArray[np.int64], entry_bytes: int, max_memory: int) -> Groups:
    """The fewest groups of neighbouring rows of tiles of at most ``max_memory`` bytes.

    Args:
        by_row: (rows,) entries of every row of tiles.
        entry_bytes: what an entry takes.
        max_memory: bytes; lists are at most 2^31 - 1 entries long in any case.

    Raises:
        BudgetError: a single row of tiles needs more.
    """
    room = min(max_memory // entry_bytes, scan.MAX_TOTAL)
    if len(by_row) and int(by_row.max()) > room:
        needed, given = int(by_row.max()) * entry_bytes, room * entry_bytes
        least, most = math.ceil(needed / 2**20 * 100) / 100, math.floor(given / 2**20 * 100) / 100
        raise BudgetError(
            f"a row of tiles needs {least:.2f} MiB, {most:.2f} MiB are allowed; "
            "raise --max-memory, or use a smaller image or fewer Gaussians",
            needed,
        )
    cuts, held, largest = [0], 0, 0
    for row, count in enumerate(by_row.tolist()):
        if held + count > room:
            cuts.append(row)
            held = 0
        held += count
        largest = max(largest, held)
    return Groups(tuple(zip(cuts, [*cuts[1:], len(by_row)], strict=True)), largest)


def forward(
    device: Device, projected: Projected, view: DeviceView, options: RenderOptions
) -> tuple[blend.Blended, Groups | None]:
    """Tiles and blending within ``options.max_memory``; waits for the device.

    Returns:
        What was drawn and the groups; or, if everything fits at once, what ``blend.forward``
        returns and None. With groups, lists and records hold no entries.
    """
    with device.stage("tiles"):
        groups, total = plan_view(device, projected, view.size, options)
    if len(groups.rows) == 1:
        with device.stage("tiles"):
            lists = tiles.forward(device, projected, view.size, options)
        with device.stage("blend forward"):
            return blend.forward(device, projected, lists, view.background, options), None
    with device.stage("tiles and blend forward"):
        whole = _no_entries(device, len(projected.opacity), view, options, total)
        for rows in groups.rows:
            _draw_rows(device, projected, whole, groups.entries, rows)
    return whole, groups


def backward(
    device: Device,
    projected: Projected,
    blended: blend.Blended,
    d_image: DeviceArray,
    groups: Groups,
) -> ProjectedGradients:
    """What ``blend.backward`` gives for one long list."""
    size, options = blended.tiles.size, blended.options
    sums = device.zeros((len(projected.opacity), blend.SUM_SIZE))
    for rows in groups.rows:
        lists = tiles.forward(device, projected, size, options, groups.entries, rows)
        records = blend.gather(device, projected, lists, options)
        blend.accumulate(device, replace(blended, tiles=lists, records=records), d_image, sums)
    return blend.finish(device, projected, sums, options)


def plan_view(
    device: Device, projected: Projected, size: tuple[int, int], options: RenderOptions
) -> tuple[Groups, int]:
    """Groups for ``options.max_memory``, and the entries of all; waits for the device."""
    by_row = tiles.count_by_row(device, projected, size, options)
    entry_bytes = LIST_BYTES[device.specialisation] + BYTES_BY_ENTRY
    unlimited = scan.MAX_TOTAL * entry_bytes
    budget = unlimited if options.max_memory is None else options.max_memory
    return plan(by_row, entry_bytes, budget), int(by_row.sum())


def _no_entries(
    device: Device, count: int, view: DeviceView, options: RenderOptions, total: int
) -> blend.Blended:
    """Room for a picture of ``count`` Gaussians; its lists are empty, but know ``total``."""
    width, height = view.size
    lists = tiles.TileLists(
        size=view.size,
        gaussian=device.empty((0,), np.int32),
        row=device.empty((0,), np.int32),
        tile_range=device.zeros((tiles.tile_count(*view.size) + 1,), np.int32),
        row_range=device.zeros((count + 1,), np.int32),
        total=device.upload(np.array([total], np.int64)),
    )
    return blend.Blended(
        image=device.empty((3, height, width)),
        transmittance=device.empty((height, width)),
        last_contributor=device.empty((height, width), np.int32),
        records=device.empty((0, blend.RECORD_SIZE)),
        tiles=lists,
        background=view.background,
        options=options,
    )


def _draw_rows(
    device: Device, projected: Projected, whole: blend.Blended, entries: int, rows: tuple[int, int]
) -> None:
    """Draw the tiles of some rows, ``rows`` being the first and the end, into ``whole``."""
    size, options = whole.tiles.size, whole.options
    lists = tiles.forward(device, projected, size, options, entries, rows)
    part = blend.forward(device, projected, lists, whole.background, options)
    width, height = size
    first, end = (min(row * TILE_SIZE, height) * width for row in rows)
    for channel in range(3):
        start = channel * width * height + first
        device.copy_part(part.image, whole.image, start, end - first)
    device.copy_part(part.transmittance, whole.transmittance, first, end - first)
    device.copy_part(part.last_contributor, whole.last_contributor, first, end - first)
