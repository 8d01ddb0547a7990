"""Blend the Gaussians of every tile into pictures of any number of channels, front to back.

The formulas are those of ``clgs.ops.blend``, with the colors of a Gaussian as they are, its depth
as one more channel if asked for, and the largest alpha as an argument. The backward pass takes the
gradient of the transmittance, too, and can sum absolute gradients by the centres (AbsGS). More
than CHUNK colors are blended in several launches, whose gradients add up.

Sources: 3DGS (Kerbl et al. 2023); AbsGS (Ye et al. 2024); the whitened moments are our own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.opencl.grid import LaunchSizes, by_items
from clgs.opencl.kernel import Argument
from clgs.ops import blend
from clgs.ops.project import Projected
from clgs.ops.tiles import TileLists, tile_count
from clgs.options import RenderOptions
from clgs.shapes import Shapes

CHUNK = 32
"""Most colors of a launch."""

FEW_REGISTERS_CHUNK = 16
"""The same of the forward pass on a GPU of Intel, which has registers for no more; same bits."""

FIXED_SUMS = 8
"""Sums of a Gaussian before those of its channels."""


@dataclass(frozen=True)
class Picture:
    """A picture of C channels, and how it is blended.

    image (H, W, C), transmittance (H, W) and 1 minus it, alpha, float32; last_contributor (H, W)
    int32, as in ``clgs.ops.blend``; background (C,) float32; with_depth: whether the last channel
    is the depth; alpha_max: where alpha saturates.
    """

    image: DeviceArray
    transmittance: DeviceArray
    alpha: DeviceArray
    last_contributor: DeviceArray
    background: DeviceArray
    with_depth: bool
    alpha_max: float
    options: RenderOptions


@dataclass(frozen=True)
class ChannelGradients:
    """Gradients by N projected Gaussians, float32; zero for those that touch nothing.

    d_mean2d (N, 2) per pixel, d_whitening (N, 3), d_opacity (N,), d_color (N, D), d_depth (N,) and
    d_absolute (N, 2): sums over the pixels of the absolute gradients by x and y. The last two are
    None if the picture has no depth, or if they are not asked for.
    """

    d_mean2d: DeviceArray
    d_whitening: DeviceArray
    d_opacity: DeviceArray
    d_color: DeviceArray
    d_depth: DeviceArray | None
    d_absolute: DeviceArray | None


def empty_picture(
    device: Device,
    size: tuple[int, int],
    background: DeviceArray,
    with_depth: bool,
    alpha_max: float,
    options: RenderOptions,
) -> Picture:
    """Room for a picture of ``size``, width and height in pixels, with a channel per background."""
    width, height = size
    pixels = height, width
    return Picture(
        **device.empty_together(
            image=(*pixels, len(background)), transmittance=pixels, alpha=pixels
        ),
        last_contributor=device.empty(pixels, np.int32),
        background=background,
        with_depth=with_depth,
        alpha_max=alpha_max,
        options=options,
    )


def gather(
    device: Device, projected: Projected, tiles: TileLists, options: RenderOptions
) -> DeviceArray:
    """Records of the entries of ``tiles``; see ``clgs.ops.blend``."""
    count, colors = projected.color.shape
    if colors != 3:  # records have room for three, which nobody reads
        projected = replace(projected, color=device.zeros((count, 3)))
    return blend.gather(device, projected, tiles, options)


def forward(
    device: Device,
    projected: Projected,
    tiles: TileLists,
    records: DeviceArray,
    picture: Picture,
    rows: tuple[int, int],
) -> None:
    """Fill the rows of tiles of ``picture``, from the first to the end, that ``tiles`` lists.

    ``projected.color``: (N, D) float32; the picture has D channels, and the depth's if asked for.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(projected, tiles, picture)
    chunk = FEW_REGISTERS_CHUNK if device.has_few_registers else CHUNK
    for defines, arguments in _launches(device, projected, tiles, records, picture, rows, chunk):
        device.run(
            device.kernel("channels/forward", "channels_forward", **defines),
            *_grid(device, tiles, rows),
            **arguments,
            image=picture.image,
            transmittance=picture.transmittance,
            alpha=picture.alpha,
            last_contributor=picture.last_contributor,
        )


def empty_sums(device: Device, count: int, picture: Picture) -> DeviceArray:
    """Room for the sums of :func:`accumulate`."""
    return device.empty((count, FIXED_SUMS + len(picture.background)))


def accumulate(
    device: Device,
    projected: Projected,
    tiles: TileLists,
    records: DeviceArray,
    picture: Picture,
    rows: tuple[int, int],
    d_image: DeviceArray,
    d_left: DeviceArray | None,
    sums: DeviceArray,
    absolute: bool = False,
) -> None:
    """Add to ``sums`` what the entries of ``tiles`` contribute to the gradients.

    The rows of tiles that begin with 0 come first: they set the sums.

    Args:
        device: where the arrays live.
        projected: as for :func:`forward`, which made ``picture`` of it.
        tiles: as for :func:`forward`; groups of rows follow each other in their order.
        records: as for :func:`forward`.
        picture: as for :func:`forward`.
        rows: as for :func:`forward`.
        d_image: (H, W, C) float32.
        d_left: (H, W) float32, by the transmittance, without what the background adds;
            None for zeros.
        sums: (N, 8 + C) float32, from :func:`empty_sums`.
        absolute: whether to sum absolute gradients.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    _check(projected, tiles, picture)
    height, width, channels = picture.image.shape
    shapes = Shapes(H=height, W=width, C=channels)
    shapes.check("d_image", d_image, "H W C", np.float32)
    if d_left is not None:
        shapes.check("d_left", d_left, "H W", np.float32)
    count, entries = len(projected.opacity), len(tiles.gaussian)
    for defines, arguments in _launches(device, projected, tiles, records, picture, rows, CHUNK):
        defines = {**defines, "WITH_ABSOLUTE": int(absolute), "FIXED_SUMS": FIXED_SUMS}
        first = arguments["first"]
        left = None if first else d_left
        moments = 6 + 2 * absolute + int(defines["CHANNELS"]) + int(defines["WITH_DEPTH"])
        moment_rows = device.empty((entries, round_up(moments, 8)))
        device.run(
            device.kernel("channels/backward", "channels_backward", **defines),
            *_grid(device, tiles, rows),
            **arguments,
            transmittance=picture.transmittance,
            last_contributor=picture.last_contributor,
            d_image=d_image,
            d_left=d_image if left is None else left,
            with_left=np.int32(left is not None),
            rows=moment_rows,
        )
        device.run(
            device.kernel("channels/sums", "channels_accumulate", **defines),
            *by_items(count),
            rows=moment_rows,
            row_range=tiles.row_range,
            count=np.int32(count),
            first=first,
            fresh=np.int32(rows[0] == 0),
            sums_pitch=np.int32(FIXED_SUMS + channels),
            sums=sums,
        )


def finish(
    device: Device,
    projected: Projected,
    picture: Picture,
    sums: DeviceArray,
    absolute: bool = False,
) -> ChannelGradients:
    """Gradients from the sums that :func:`accumulate` made."""
    count, colors = projected.color.shape
    Shapes(N=count, S=FIXED_SUMS + len(picture.background)).check("sums", sums, "N S", np.float32)
    made = device.empty_together(
        d_mean2d=(count, 2),
        d_whitening=(count, 3),
        d_opacity=(count,),
        d_color=(count, colors),
        d_depth=(count,) if picture.with_depth else None,
        d_absolute=(count, 2) if absolute else None,
    )
    result = ChannelGradients(**made)
    unused = device.empty((1,))
    shown = {"WITH_DEPTH": int(picture.with_depth), "WITH_ABSOLUTE": int(absolute)}
    device.run(
        device.kernel("channels/sums", "channels_finish", **shown, FIXED_SUMS=FIXED_SUMS),
        *by_items(count),
        sums=sums,
        count=np.int32(count),
        sums_pitch=np.int32(sums.shape[1]),
        colors=np.int32(colors),
        whitening=projected.whitening,
        opacity=projected.opacity,
        **{name: unused if array is None else array for name, array in vars(result).items()},
    )
    return result


def _launches(
    device: Device,
    projected: Projected,
    tiles: TileLists,
    records: DeviceArray,
    picture: Picture,
    rows: tuple[int, int],
    chunk: int,
) -> Iterator[tuple[dict[str, int | float], dict[str, Argument]]]:
    """Build options and common arguments of the launches, of at most ``chunk`` colors each."""
    colors = projected.color.shape[1]
    height, width = picture.transmittance.shape
    usual = {**blend.defines(device, picture.options), "ALPHA_MAX": picture.alpha_max}
    for first in range(0, max(colors, 1), chunk):
        count = min(chunk, colors - first)
        depth = picture.with_depth and first + count == colors
        defines = {**usual, "CHANNELS": count, "WITH_DEPTH": int(depth)}
        yield (
            defines,
            {
                "records": records,
                "gaussian": tiles.gaussian,
                "tile_range": tiles.tile_range,
                "first_tile": np.int32(rows[0] * tile_count(width, 1)),
                "color": projected.color,
                "depth": projected.depth,
                "first": np.int32(first),
                "pitch": np.int32(colors),
                "background": picture.background,
                "width": np.int32(width),
                "height": np.int32(height),
                "image_pitch": np.int32(len(picture.background)),
            },
        )


def _grid(device: Device, tiles: TileLists, rows: tuple[int, int]) -> LaunchSizes:
    """Launch sizes for rows of tiles; see ``blend.tile_grid``."""
    whole, group = blend.tile_grid(device, tiles)
    share = (rows[1] - rows[0]) * tile_count(tiles.size[0], 1)
    return (whole[0] // (len(tiles.tile_range) - 1) * share,), group


def _check(projected: Projected, tiles: TileLists, picture: Picture) -> None:
    channels = projected.color.shape[1] + picture.with_depth
    shapes = Shapes(C=channels, W=tiles.size[0], H=tiles.size[1])
    shapes.check("color", projected.color, "N D", np.float32)
    shapes.check("depth", projected.depth, "N", np.float32)
    shapes.check("opacity", projected.opacity, "N", np.float32)
    shapes.check("whitening", projected.whitening, "N 3", np.float32)
    shapes.check("background", picture.background, "C", np.float32)
    shapes.check("image", picture.image, "H W C", np.float32)
