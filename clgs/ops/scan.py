"""Exclusive prefix sums: where each item's output starts.

offsets[i] = counts[0] + ... + counts[i-1]. The total is summed in 64 bits and checked before anyone
allocates that much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.opencl.grid import ANY_GROUP, LaunchSizes, by_items
from clgs.opencl.kernel import Argument
from clgs.opencl.programs import SCAN_GROUP_SIZE
from clgs.shapes import Shapes

MAX_TOTAL = 2**31 - 1
EXACT = 2**63 - 1
"""Room for exactly as many as there are: the host waits until it knows the number."""

LACKS_ROOM = 2
"""Bit of the stop flag (see ``clgs.ops.adam``): an array was too short for what belongs in it."""

SHORTEST_CHUNK = {"cpu": 32768, "gpu": 1024}
MOST_CHUNKS = {"cpu": 32, "gpu": 256}
"""Every chunk adds up the sums of all parts before it, so they are few."""


@dataclass(frozen=True)
class Offsets:
    """``offset`` (n + 1,) int32, the last entry being the total; ``total`` (1,) int64."""

    offset: DeviceArray
    total: DeviceArray


@dataclass(frozen=True)
class PartSums:
    """``sum`` (parts,) int64 of ``length`` counts each; of the last part, of those that are left.

    A kernel that counts leaves them (scan/part_sums.h), which saves a launch that reads the counts.
    """

    sum: DeviceArray
    length: int


def exclusive(device: Device, counts: DeviceArray) -> tuple[DeviceArray, int]:
    """Offsets (n,) int32 of non-negative counts (n,) int32, and their total; waits for the device.

    The buffer of the offsets has one more entry, the total.

    Raises:
        ClgsError: the total does not fit in 31 bits.
        ValueError, TypeError: ``counts`` has the wrong shape or dtype.
    """
    result = on_device(device, counts)
    total = checked_total(device, result)
    return DeviceArray(result.offset.buffer, counts.shape, result.offset.dtype), total


def checked_total(device: Device, offsets: Offsets) -> int:
    """Download the total; waits for the device.

    Raises:
        ClgsError: the total does not fit in 31 bits.
    """
    total = int(device.download(offsets.total)[0])
    if total > MAX_TOTAL:
        raise ClgsError(
            f"{total} entries are needed, at most {MAX_TOTAL} fit; "
            "use --max-memory, a smaller image or fewer Gaussians"
        )
    return total


def room_for(device: Device, offsets: Offsets, room: int) -> int:
    """Length of the array that ``offsets`` lead into: ``room``, or the total if that is EXACT.

    Raises:
        ClgsError: the room is EXACT, and the total does not fit in 31 bits.
    """
    return checked_total(device, offsets) if room == EXACT else room


def on_device(
    device: Device, counts: DeviceArray, limit: int = EXACT, parts: PartSums | None = None
) -> Offsets:
    """The offsets of :func:`exclusive`, without a download; all are 0 if total > limit.

    ``parts``: sums of the same counts; by default they are added up here.
    """
    shapes = Shapes()
    shapes.check("counts", counts, "n", np.int32)
    count = shapes.axes["n"]
    chunk, chunks = chunk_plan(device, count, 1 if parts is None else parts.length)
    offset, total = device.empty((count + 1,), np.int32), device.empty((1,), np.int64)
    wide = SCAN_GROUP_SIZE if device.specialisation == "gpu" else 1
    grid = (chunks * wide,), (wide,)
    items: dict[str, Argument] = {
        "counts": counts,
        "count": np.int32(count),
        "chunk": np.int32(chunk),
    }
    if parts is None:
        parts = PartSums(device.empty((chunks,), np.int64), chunk)
        reduce = device.kernel("scan/offsets", "scan_reduce")
        device.run(reduce, *grid, **items, sums=parts.sum)
    device.run(
        device.kernel("scan/offsets", "scan_apply"),
        *grid,
        **items,
        sums=parts.sum,
        parts=np.int32(len(parts.sum)),
        part=np.int32(parts.length),
        limit=np.int64(limit),
        total=total,
        offsets=offset,
    )
    return Offsets(offset, total)


def parts_of(device: Device, count: int, lanes: int) -> PartSums:
    """Room for the sums of what a kernel counts whose work-items take ``lanes`` items each."""
    length = SCAN_GROUP_SIZE if device.specialisation == "gpu" else lanes
    return PartSums(device.empty((-(-count // length),), np.int64), length)


def counting_grid(device: Device, count: int, lanes: int, group: int = ANY_GROUP) -> LaunchSizes:
    """Launch size of such a kernel; ``group``: work-items of a work-group on a CPU."""
    return by_items(
        -(-count // lanes), SCAN_GROUP_SIZE if device.specialisation == "gpu" else group
    )


def check_fits(
    device: Device,
    totals: tuple[DeviceArray, DeviceArray, DeviceArray],
    rooms: tuple[int, int, int],
    stop: DeviceArray,
) -> DeviceArray:
    """Set LACKS_ROOM in ``stop`` (1,) int32 if a total, (1,) int64, is above its room.

    Returns the totals in one array, (3,) int64. Waits for nothing.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    for total in totals:
        shapes.check("total", total, "1", np.int64)
    shapes.check("stop", stop, "1", np.int32)
    gathered = device.empty((len(totals),), np.int64)
    device.run(
        device.kernel("scan/fits", "scan_fits", LACKS_ROOM=LACKS_ROOM),
        *((1,), (1,)),
        first=totals[0],
        second=totals[1],
        third=totals[2],
        capacity=np.array([*rooms, 0], np.int64),
        totals=gathered,
        stop=stop,
    )
    return gathered


def chunk_plan(device: Device, count: int, part: int) -> tuple[int, int]:
    """(items per chunk, a multiple of ``part``, chunks): few long ones on a CPU, more on a GPU."""
    shortest, most = (table[device.specialisation] for table in (SHORTEST_CHUNK, MOST_CHUNKS))
    chunks = max(1, min(most, count // shortest))
    chunk = round_up(max(1, -(-count // chunks)), part)
    return chunk, max(1, -(-count // chunk))
