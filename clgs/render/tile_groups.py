"""Draw a view in groups of rows of tiles, so that what is stored per entry keeps to a budget.

Only the picture, the transmittance and the last contributors stay of a group. The backward pass
makes its lists again and adds its rows of gradients to sums by Gaussian. A Gaussian's rows are in
the order of its tiles, and so are the groups: the sums have the bits of those over one long list.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.errors import BudgetError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, scan, tiles
from clgs.ops.neural import NeuralGaussians
from clgs.ops.project import Projected
from clgs.ops.project_anchors import Splats
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
        raise BudgetError(
            f"a row of tiles needs {needed / 2**20:.1f} MiB, {given / 2**20:.1f} MiB are allowed; "
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


def plan_view(
    device: Device,
    projected: Projected,
    gaussians: NeuralGaussians | Splats,
    size: tuple[int, int],
    options: RenderOptions,
) -> tuple[Groups, int]:
    """Groups for ``options.max_memory``, and the entries of all; waits for the device."""
    by_row = tiles.count_by_row(device, projected, gaussians.opacity, *size, options)
    entry_bytes = LIST_BYTES[device.specialisation] + BYTES_BY_ENTRY
    unlimited = scan.MAX_TOTAL * entry_bytes
    budget = unlimited if options.max_memory is None else options.max_memory
    return plan(by_row, entry_bytes, budget), int(by_row.sum())


def forward(
    device: Device,
    projected: Projected,
    gaussians: NeuralGaussians | Splats,
    view: DeviceView,
    options: RenderOptions,
    groups: Groups,
) -> blend.Blended:
    """Blend group by group; the records of the result hold no entries."""
    width, height = view.size
    whole = blend.Blended(
        image=device.empty((3, height, width)),
        transmittance=device.empty((height, width)),
        last_contributor=device.empty((height, width), np.int32),
        records=device.empty((0, blend.RECORD_SIZE)),
        options=options,
    )
    for rows in groups.rows:
        lists = _lists(device, projected, gaussians, view.size, options, rows, groups.entries)
        colors = gaussians.color, gaussians.opacity
        part = blend.forward(device, projected, *colors, lists, view.background, view.size, options)
        first, end = (min(row * TILE_SIZE, height) * width for row in rows)
        for channel in range(3):
            start = channel * width * height + first
            device.copy_part(part.image, whole.image, start, end - first)
        device.copy_part(part.transmittance, whole.transmittance, first, end - first)
        device.copy_part(part.last_contributor, whole.last_contributor, first, end - first)
    return whole


def backward(
    device: Device,
    projected: Projected,
    gaussians: NeuralGaussians | Splats,
    background: DeviceArray,
    blended: blend.Blended,
    d_image: DeviceArray,
    groups: Groups,
) -> blend.BlendGradients:
    """What ``blend.backward`` gives for one long list."""
    height, width = blended.transmittance.shape
    options, colors = blended.options, (gaussians.color, gaussians.opacity)
    sums = device.zeros((len(gaussians.opacity), blend.SUM_SIZE))
    for rows in groups.rows:
        lists = _lists(device, projected, gaussians, (width, height), options, rows, groups.entries)
        records = blend.gather(device, projected, *colors, lists, width, options)
        part = replace(blended, records=records)
        blend.accumulate(device, lists, background, part, d_image, sums)
    return blend.finish(device, projected, *colors, sums, options)


def no_lists(device: Device, count: int, size: tuple[int, int], total: int) -> tiles.TileLists:
    """Empty lists of ``count`` Gaussians that know how many entries there would be."""
    return tiles.TileLists(
        gaussian=device.empty((0,), np.int32),
        row=device.empty((0,), np.int32),
        tile_range=device.zeros((tiles.tile_count(*size) + 1,), np.int32),
        row_range=device.zeros((count + 1,), np.int32),
        total=device.upload(np.array([total], np.int64)),
    )


def _lists(
    device: Device,
    projected: Projected,
    gaussians: NeuralGaussians | Splats,
    size: tuple[int, int],
    options: RenderOptions,
    rows: tuple[int, int],
    capacity: int,
) -> tiles.TileLists:
    """Lists of a group; all have the same length, so that the next ones take their memory."""
    return tiles.forward(device, projected, gaussians.opacity, *size, options, capacity, rows)
