"""Anchors come and go while training goes on, and no row that stays is moved.

An anchor that goes is hidden: its position becomes NaN, so that no view sees it (``cull``), its
counts become 0, and its slots ask for nothing. New anchors are rows after the last one.
:func:`take` moves the rows that are left together.

Source: Scaffold-GS, section 3.3; Voxel-GS adds :func:`hide_undrawn` (section 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.opencl.kernel import Argument
from clgs.ops.density import DeviceStatistics
from clgs.scene.anchors import DeviceAnchors
from clgs.shapes import Shapes

PLACE_DIM = 6


@dataclass(frozen=True)
class NewAnchors:
    """N anchors to add, of which each has parents among the A anchors that there are.

    position (N, 3) float32 scene units; edge (N,) float32, all six scalings; first (N + 1,) int32:
    the parents of anchor i are parents[first[i] : first[i + 1]], at least one; parents int32.
    """

    position: npt.NDArray[np.float32]
    edge: npt.NDArray[np.float32]
    first: npt.NDArray[np.int32]
    parents: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.edge)


def hide_undrawn(
    device: Device,
    anchors: DeviceAnchors,
    statistics: DeviceStatistics,
    visible: DeviceArray,
    output: DeviceArray,
) -> None:
    """Hide the anchors that a view sees without drawing anything of them, in place.

    Offsets of slots that are not drawn become 0 in the visible anchors that stay.

    ``visible`` (V,) int32: anchors, each at most once, -1 for none; ``output`` (at least K, Vp)
    float32, Vp >= V: its first K rows are opacities, and a slot is drawn if its is above 0.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(anchors, statistics)
    shapes = Shapes()
    shapes.check("visible", visible, "V", np.int32)
    shapes.check("output", output, "rows Vp", np.float32)
    if len(output) < K_OFFSETS or output.shape[1] < len(visible):
        raise ValueError(f"output: shape is {output.shape}, {len(visible)} anchors are visible")
    _run(
        device,
        "growth_hide_undrawn",
        len(visible),
        opacity=output,
        visible=visible,
        count=np.int32(len(visible)),
        padded=np.int32(output.shape[1]),
        position=anchors.position,
        offset=anchors.offset,
        visits=statistics.visits,
        gradient_count=statistics.gradient_count,
    )


def prune(
    device: Device,
    anchors: DeviceAnchors,
    statistics: DeviceStatistics,
    visits: int,
    least_opacity: float,
    most_scaling: float,
) -> npt.NDArray[np.intp]:
    """Hide anchors that stayed transparent, in place; their rows, ascending. Waits for the device.

    Of the anchors visited more than ``visits`` times, those with a summed opacity below
    ``least_opacity`` per visit go, and the sums of the others are zeroed. Log scales of shapes,
    ``scaling[:, 3:]``, are brought down to ``most_scaling``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(anchors, statistics)
    count = len(anchors)
    gone = device.empty((count,), np.int32)
    _run(
        device,
        "growth_prune",
        count,
        count=np.int32(count),
        often=np.int32(visits),
        least=np.float32(least_opacity),
        most=np.float32(most_scaling),
        position=anchors.position,
        scaling=anchors.scaling,
        opacity_sum=statistics.opacity_sum,
        visits=statistics.visits,
        gradient_count=statistics.gradient_count,
        gone=gone,
    )
    return np.flatnonzero(device.download(gone))


def asking(
    device: Device, statistics: DeviceStatistics, seen: int, least: float
) -> npt.NDArray[np.intp]:
    """Slots, anchor * K + offset, ascending, seen more often than ``seen`` times with large sums.

    That is at least ``least`` per time, in float32. Waits for the device.
    """
    asks = device.empty((statistics.gradient_sum.size,), np.uint8)
    _run(
        device,
        "growth_ask",
        len(asks),
        count=np.int32(len(asks)),
        seen=np.int32(seen),
        least=np.float32(least),
        gradient_sum=statistics.gradient_sum,
        gradient_count=statistics.gradient_count,
        asks=asks,
    )
    return np.flatnonzero(device.download(asks))


def places(
    device: Device, anchors: DeviceAnchors, slots: npt.NDArray[np.integer]
) -> npt.NDArray[np.float32]:
    """(n, 6): offset, and the log scale that it is multiplied by, of ``slots`` (n,).

    A slot is number anchor * K + offset. Waits for the device.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype, or there is no such slot.
    """
    anchors.check(np.float32)
    _check_rows("slots", slots, K_OFFSETS * len(anchors))
    place = device.empty((len(slots), PLACE_DIM))
    _run(
        device,
        "growth_places",
        len(slots),
        slots=device.upload(slots.astype(np.int32)),
        count=np.int32(len(slots)),
        offset=anchors.offset,
        scaling=anchors.scaling,
        place=place,
    )
    return device.download(place)


def restart(device: Device, statistics: DeviceStatistics, seen: int) -> None:
    """Zero the sums of slots that were seen more often than ``seen`` times, in place."""
    count = statistics.gradient_sum.size
    _run(
        device,
        "growth_restart",
        count,
        count=np.int32(count),
        seen=np.int32(seen),
        gradient_sum=statistics.gradient_sum,
        gradient_count=statistics.gradient_count,
    )


def append(device: Device, anchors: DeviceAnchors, new: NewAnchors) -> DeviceAnchors:
    """The anchors with ``new`` ones after them; ``anchors`` may share their memory.

    Offsets of new ones are 0, and a feature is the channel-wise maximum of those of the parents.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype, or there is no such parent.
    """
    anchors.check(np.float32)
    shapes = Shapes(N=len(new))
    shapes.check("position", new.position, "N 3", np.float32)
    shapes.check("edge", new.edge, "N", np.float32)
    shapes.check("first", new.first, f"{len(new) + 1}", np.int32)
    shapes.check("parents", new.parents, "P", np.int32)
    _check_rows("parents", new.parents, len(anchors))
    ends: Sequence[int] = (int(new.first[0]), int(new.first[-1]))
    if ends != (0, len(new.parents)) or not (np.diff(new.first) > 0).all():
        raise ValueError("first: must rise from 0 to the number of parents")
    before = len(anchors)
    longer = anchors.map(lambda array: with_zeros(device, array, len(new)))
    _run(
        device,
        "growth_append",
        FEATURE_DIM * len(new),
        place=device.upload(new.position),
        edge=device.upload(new.edge),
        first=device.upload(new.first),
        parents=device.upload(new.parents),
        count=np.int32(len(new)),
        before=np.int32(before),
        position=longer.position,
        feature=longer.feature,
        scaling=longer.scaling,
    )
    return longer


def with_zeros(device: Device, array: DeviceArray, rows: int) -> DeviceArray:
    """``array`` with ``rows`` rows of zeros after its own, in the same memory if it has room."""
    longer = device.extended(array, len(array) + rows)
    device.fill_zero(longer, array.size)
    return longer


def take(device: Device, array: DeviceArray, rows: DeviceArray) -> DeviceArray:
    """Rows ``rows`` (n,) int32 of an array of numbers of 32 bits: a new array.

    Raises:
        ValueError, TypeError: ``rows`` is no such list, or the numbers have other sizes.
    """
    Shapes().check("rows", rows, "n", np.int32)
    if array.dtype.itemsize != 4:
        raise TypeError(f"array: dtype is {array.dtype}, numbers of 32 bits are needed")
    taken = device.empty((len(rows), *array.shape[1:]), array.dtype)
    width = array.size // max(len(array), 1)
    _run(
        device,
        "growth_take",
        taken.size,
        rows=rows,
        source=array.of_type(np.int32),
        total=np.uint32(taken.size),
        width=np.uint32(width),
        taken=taken.of_type(np.int32),
    )
    return taken


def _run(device: Device, kernel: str, items: int, **arguments: Argument) -> None:
    built = device.kernel("anchors/growth", kernel, PLACE_DIM=PLACE_DIM)
    device.run(built, *by_items(items), **arguments)


def _check(anchors: DeviceAnchors, statistics: DeviceStatistics) -> None:
    anchors.check(np.float32)
    shapes = Shapes(A=len(anchors), K=K_OFFSETS)
    shapes.check("visits", statistics.visits, "A", np.int32)
    shapes.check("gradient_count", statistics.gradient_count, "A K", np.int32)


def _check_rows(name: str, rows: npt.NDArray[np.integer], count: int) -> None:
    if rows.ndim != 1 or not ((rows >= 0) & (rows < count)).all():
        raise ValueError(f"{name}: must be a list of numbers from 0 to {count - 1}")
