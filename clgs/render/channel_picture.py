"""Pictures of any number of channels from projected Gaussians, and the way back.

A picture is drawn at once, or in groups of rows of tiles that keep to a memory budget, of which the
backward pass makes lists and records again. Both give the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import tiles
from clgs.ops.general import channels
from clgs.ops.general.channels import ChannelGradients, Picture
from clgs.ops.project import Projected
from clgs.options import RenderOptions
from clgs.render import tile_groups

Rows = tuple[int, int]
Part = tuple[tiles.TileLists, DeviceArray]
"""The lists of some rows of tiles, and the records of their entries."""


@dataclass(frozen=True)
class Drawn:
    """A picture, and what its gradients need.

    groups: the rows of tiles that were drawn together; whole: the part of all rows, None if they
    were drawn in several groups.
    """

    projected: Projected
    size: tuple[int, int]
    picture: Picture
    groups: tuple[Rows, ...]
    whole: Part | None


def draw(
    device: Device,
    projected: Projected,
    size: tuple[int, int],
    background: DeviceArray,
    with_depth: bool,
    alpha_max: float,
    options: RenderOptions,
    lists: tiles.TileLists | None = None,
) -> Drawn:
    """Blend ``projected.color`` (N, D), and the depth as a last channel if asked for.

    Waits for the device.

    Args:
        device: where the arrays live.
        projected: N Gaussians.
        size: width and height, pixels.
        background: (channels,) float32.
        with_depth: see above.
        alpha_max: where alpha saturates.
        options: accuracy and memory budget.
        lists: the lists of all tiles, if others than those of the stage are wanted.

    Raises:
        BudgetError: a row of tiles needs more than ``options.max_memory``.
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    made = channels.empty_picture(device, size, background, with_depth, alpha_max, options)
    groups: tuple[Rows, ...] = ((0, tiles.tile_count(1, size[1])),)
    if options.max_memory is not None and lists is None:
        split = tile_groups.within_budget(device, projected, size, options)
        groups = groups if split is None else split.rows
    whole = None
    for rows, part in _parts(device, projected, size, options, groups, lists):
        with device.stage("channels forward"):
            channels.forward(device, projected, *part, made, rows)
        whole = part if len(groups) == 1 else None
    return Drawn(projected, size, made, groups, whole)


def backward(
    device: Device,
    drawn: Drawn,
    d_image: DeviceArray,
    d_left: DeviceArray | None,
    absolute: bool = False,
) -> ChannelGradients:
    """Gradients by the projected Gaussians from those of image and transmittance.

    ``d_image`` (H, W, C) and ``d_left`` (H, W), float32, or None for zeros; ``absolute``: see
    ``clgs.ops.general.channels``.
    """
    picture, projected = drawn.picture, drawn.projected
    with device.stage("channels backward"):
        sums = channels.empty_sums(device, len(projected.opacity), picture)
        parts = (
            _parts(device, projected, drawn.size, picture.options, drawn.groups)
            if drawn.whole is None
            else [(drawn.groups[0], drawn.whole)]
        )
        for rows, part in parts:
            channels.accumulate(
                device, projected, *part, picture, rows, d_image, d_left, sums, absolute
            )
        return channels.finish(device, projected, picture, sums, absolute)


def lists_of(device: Device, drawn: Drawn) -> tiles.TileLists:
    """The lists of all tiles."""
    if drawn.whole is not None:
        return drawn.whole[0]
    return tiles.forward(device, drawn.projected, drawn.size, drawn.picture.options)


def _parts(
    device: Device,
    projected: Projected,
    size: tuple[int, int],
    options: RenderOptions,
    groups: tuple[Rows, ...],
    lists: tiles.TileLists | None = None,
) -> Iterator[tuple[Rows, Part]]:
    for rows in groups:
        with device.stage("tiles"):
            own = lists or tiles.forward(device, projected, size, options, tile_rows=rows)
            records = channels.gather(device, projected, own, options)
        yield rows, (own, records)
