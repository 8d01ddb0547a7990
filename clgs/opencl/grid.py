"""Launch sizes."""

from __future__ import annotations

from clgs.opencl.device import Device, round_up

GROUP_SIZE = {"cpu": 1, "gpu": 64}
"""Work-items of a group.

PoCL gives each work-item of a group private arrays of its own. Those of 64 of them, one after the
other, fall out of a core's cache.
"""

CHUNKS_PER_UNIT, MOST_CHUNKS = 2, 32


def by_lanes(device: Device, count: int, lanes: int) -> tuple[tuple[int], tuple[int]]:
    """Global and local size for work-items that take ``lanes`` of ``count`` elements each."""
    group = GROUP_SIZE[device.specialisation]
    return (round_up(-(-count // lanes), group),), (group,)


def chunk_count(device: Device) -> int:
    """Into how many parts a CPU's threads divide a list, of which each has tables of its own.

    Two per thread, so that none waits long for another. Results are the same for any number.
    """
    return min(CHUNKS_PER_UNIT * int(device.cl_device.max_compute_units), MOST_CHUNKS)
