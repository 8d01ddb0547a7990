"""Launch sizes."""

from __future__ import annotations

from clgs.opencl.device import Device, round_up

GROUP_SIZE = {"cpu": 1, "gpu": 64}
"""Work-items of a group.

PoCL gives each work-item of a group private arrays of its own. Those of 64 of them, one after the
other, fall out of a core's cache.
"""


def by_lanes(device: Device, count: int, lanes: int) -> tuple[tuple[int], tuple[int]]:
    """Global and local size for work-items that take ``lanes`` of ``count`` elements each."""
    group = GROUP_SIZE[device.specialisation]
    return (round_up(-(-count // lanes), group),), (group,)
