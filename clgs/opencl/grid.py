"""Launch sizes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

from clgs.opencl.device import Device, round_up
from clgs.opencl.programs import PARTS_GROUP_SIZE

Item = TypeVar("Item")
LaunchSizes = tuple[tuple[int], tuple[int]]
"""Global and local size of a launch."""

GROUP_SIZE = {"cpu": 1, "gpu": 64}
"""Work-items of a group.

PoCL gives each work-item of a group private arrays of its own. Those of 64 of them, one after the
other, fall out of a core's cache.
"""

ANY_GROUP = 64
"""Work-items of a group that shares nothing."""

CHUNKS_PER_UNIT, MOST_CHUNKS = 2, 32


def by_items(count: int, group: int | None = None) -> LaunchSizes:
    """Global and local size of ``count`` work-items, rounded up to whole groups.

    ``group``: work-items per group; by default ANY_GROUP, for kernels without local memory.
    """
    size = ANY_GROUP if group is None else group
    return (round_up(count, size),), (size,)


def by_lanes(device: Device, count: int, lanes: int) -> LaunchSizes:
    """Global and local size for work-items that take ``lanes`` of ``count`` elements each."""
    return by_items(-(-count // lanes), GROUP_SIZE[device.specialisation])


def by_parts(sizes: Iterable[int], per_item: int) -> LaunchSizes:
    """Global and local size of a launch over several arrays of ``sizes`` elements.

    Each begins with a work-group; a work-item takes ``per_item`` elements (common/parts.h).
    """
    groups = sum(-(-size // (per_item * PARTS_GROUP_SIZE)) for size in sizes)
    return (groups * PARTS_GROUP_SIZE,), (PARTS_GROUP_SIZE,)


def filled(items: Sequence[Item], count: int) -> list[Item]:
    """``items``, the last of them repeated until there are ``count``.

    A kernel takes ``count`` arrays; the repeated ones have a size of 0.
    """
    return [*items, *[items[-1]] * (count - len(items))]


def chunk_count(device: Device) -> int:
    """Into how many parts a CPU's threads divide a list, of which each has tables of its own.

    Two per thread, so that none waits long for another. Results are the same for any number.
    """
    return min(CHUNKS_PER_UNIT * int(device.cl_device.max_compute_units), MOST_CHUNKS)
