"""gsplat's functions from the screen to pixels: tile lists by boxes, and blending of given lists.

``rasterization`` lists a Gaussian for the tiles that its ellipse reaches. These lists are those of
gsplat, of its box: they are longer, and give the same picture.
"""

from __future__ import annotations

import math
import weakref

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from clgs.opencl.device import Device
from clgs.ops.tiles import TileLists, tile_count
from clgs.options import DEFAULT
from clgs.render.rasterization import ALPHA_MAX, default_device
from clgs.render.splat_arguments import check_size, check_tile_size
from clgs.torch.functions import Blend
from clgs.torch.tensors import BlendCall, check_shapes, eager, host_of, needed


@eager
@torch.no_grad()  # type: ignore[untyped-decorator]  # torch is Any
def isect_tiles(
    means2d: Tensor,
    radii: Tensor,
    depths: Tensor,
    tile_size: int,
    tile_width: int,
    tile_height: int,
    sort: bool = True,
    segmented: bool = False,
    packed: bool = False,
    n_images: int | None = None,
    image_ids: Tensor | None = None,
    gaussian_ids: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """The tiles that boxes overlap, as ``gsplat.isect_tiles``.

    Args:
        means2d: (..., N, 2) pixels, of images ``...``; or (M, 2), packed.
        radii: (..., N, 2) or (M, 2) int32, pixels; none if one is 0.
        depths: (..., N) or (M,) float32.
        tile_size: pixels.
        tile_width: tiles in a row.
        tile_height: tiles in a column.
        sort: whether by image, tile and depth, ties by row; else by row.
        segmented: has no effect.
        packed: whether rows are packed.
        n_images: number of images, if packed.
        image_ids: (M,) the image of each row, if packed.
        gaussian_ids: has no effect.

    Returns:
        Tiles of each Gaussian, (..., N) or (M,) int32; of each of I entries image, tile and the
        bits of the depth in one int64; its row (I,) int32.

    Raises:
        ValueError: an argument has the wrong shape, or is missing.
    """
    if packed and (n_images is None or image_ids is None):
        raise ValueError("n_images, image_ids: packed rows need both")
    if min(tile_size, tile_width, tile_height) <= 0:
        sizes = tile_size, tile_width, tile_height
        raise ValueError(f"tile_size, tile_width, tile_height: {sizes} are not above 0")
    rows = needed("depths", depths).shape
    boxes = {"means2d": needed("means2d", means2d), "radii": needed("radii", radii)}
    check_shapes({name: (one, (*rows, 2), None) for name, one in boxes.items()})
    check_shapes({"image_ids": (image_ids, rows, None)})
    given = image_ids if packed and image_ids is not None else torch.zeros(0)
    if torch.any((given < 0) | (given >= (n_images or 0))):
        raise ValueError(f"image_ids: {tuple(rows)} has others than 0 to {n_images} - 1")
    centre, radius = means2d.reshape(-1, 2) / tile_size, radii.reshape(-1, 2) / tile_size
    end = torch.tensor([tile_width, tile_height])
    first = torch.floor(centre - radius).clamp(min=0).minimum(end).long()
    spans = torch.ceil(centre + radius).clamp(min=0).minimum(end).long() - first
    counts = torch.where((radius > 0).all(dim=-1), spans.prod(dim=-1), 0)
    row = torch.repeat_interleave(counts)
    number = torch.arange(len(row)) - (counts.cumsum(0) - counts)[row]
    wide = spans[row, 0]
    tile = (first[row, 1] + number // wide) * tile_width + first[row, 0] + number % wide
    image = row // max(means2d.shape[-2], 1) if image_ids is None else image_ids[row].long()
    bits = (tile_width * tile_height).bit_length()
    depth = depths.reshape(-1).float().contiguous().view(torch.int32)[row].long() & 0xFFFFFFFF
    ids = image << (32 + bits) | tile << 32 | depth
    if sort:
        ids, order = torch.sort(ids, stable=True)
        row = row[order]
    return counts.int().reshape(depths.shape), ids, row.int()


@eager
@torch.no_grad()  # type: ignore[untyped-decorator]  # torch is Any
def isect_offset_encode(
    isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int
) -> Tensor:
    """First entry (n_images, tile_height, tile_width) int32 of every tile, as gsplat's.

    ``isect_ids``: (I,) int64, sorted, of :func:`isect_tiles`.

    Raises:
        ValueError, TypeError: they have another shape or dtype, are not sorted, or name a tile or
            an image that is not there.
    """
    check_shapes({"isect_ids": (isect_ids, (len(needed("isect_ids", isect_ids)),), torch.int64)})
    tiles, places = tile_width * tile_height, isect_ids >> 32
    bits = tiles.bit_length()
    known = (places & (1 << bits) - 1 < tiles) & (places >> bits < n_images) & (places >= 0)
    if not known.all():
        raise ValueError(f"isect_ids: has entries beyond {n_images} images of {tiles} tiles")
    if (isect_ids.diff() < 0).any():
        raise ValueError("isect_ids: is not sorted; see isect_tiles")
    wanted = torch.arange(n_images)[:, None] << bits | torch.arange(tiles)
    found = torch.searchsorted(places, wanted.reshape(-1))
    return found.int().reshape(n_images, tile_height, tile_width)


@eager
def rasterize_to_pixels(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
    backgrounds: Tensor | None = None,
    masks: Tensor | None = None,
    packed: bool = False,
    absgrad: bool = False,
) -> tuple[Tensor, Tensor]:
    """Blend the Gaussians of given tile lists, as ``gsplat.rasterize_to_pixels``.

    Gradients flow to all floats; ``means2d`` receives ``absgrad``. A Gaussian whose conic is not
    positive definite is not drawn.

    Args:
        means2d: (..., N, 2) float32 pixels, of images ``...``; or (M, 2), packed.
        conics: (..., N, 3) or (M, 3) float32, inverse covariances xx, xy, yy.
        colors: (..., N, D) or (M, D) float32.
        opacities: (..., N) or (M,) float32.
        image_width: pixels.
        image_height: pixels.
        tile_size: 16.
        isect_offsets: (..., rows, columns) int32, from :func:`isect_offset_encode`.
        flatten_ids: (I,) int32, from :func:`isect_tiles`.
        backgrounds: (..., D) float32.
        masks: (..., rows, columns) bool; a tile shows only the background if false.
        packed: whether rows are packed.
        absgrad: whether to sum absolute gradients by the centres, too.

    Returns:
        colors (..., H, W, D) and alphas (..., H, W, 1), float32.

    Raises:
        NotImplementedError: the tile size is not 16.
        TypeError, ValueError: an argument cannot be used; names it and its shape.
    """
    check_tile_size(tile_size)
    size = image_width, image_height
    check_size(*size)
    required = {
        "means2d": means2d, "conics": conics, "colors": colors, "opacities": opacities,
        "isect_offsets": isect_offsets, "flatten_ids": flatten_ids,
    }  # fmt: skip
    for name, tensor in required.items():
        if not needed(name, tensor).ndim:
            raise ValueError(f"{name}: shape is ()")
    images = tuple(isect_offsets.shape[:-2])
    channels = colors.shape[-1]
    rows = tuple(means2d.shape[:-1]) if packed else (*images, *means2d.shape[-2:-1])
    grid = (*images, tile_count(1, image_height), tile_count(image_width, 1))
    expected = {
        "means2d": (means2d, (*rows, 2), None),
        "conics": (conics, (*rows, 3), None),
        "colors": (colors, (*rows, channels), None),
        "opacities": (opacities, rows, None),
        "isect_offsets": (isect_offsets, grid, torch.int32),
        "flatten_ids": (flatten_ids, (len(flatten_ids),), torch.int32),
        "backgrounds": (backgrounds, (*images, channels), torch.float32),
        "masks": (masks, grid, torch.bool),
    }
    check_shapes(expected)
    count, pictures = rows[-1], math.prod(images)
    drawn, whitening = _whitening(conics)
    floats = means2d, whitening, torch.where(drawn, opacities, 0.0), colors
    centres, factors, shown, color = (
        one.float().expand(pictures, *one.shape).unsqueeze(1) if packed
        else one.float().reshape(pictures, 1, count, *one.shape[len(rows) :])
        for one in floats
    )  # fmt: skip
    device = default_device()
    numbers = host_of(flatten_ids).astype(np.int64), host_of(isect_offsets).astype(np.int64)
    shown_tiles = None if masks is None else host_of(masks)
    lists = _lists(device, size, count, packed, *numbers, shown_tiles)
    shade = centres.new_zeros(*images, channels) if backgrounds is None else backgrounds
    shade, depths = shade.reshape(pictures, 1, channels), centres.new_zeros(pictures, 1, count)
    how = DEFAULT, False, ALPHA_MAX, absgrad, host_of(shade), images, host_of(color)
    call = BlendCall(device, size, *how, lists=lists)
    call.centres = weakref.ref(means2d)
    image, alphas = Blend.apply(call, centres, factors, depths, shown, centres, color, shade)
    return image, alphas


def _whitening(conics: Tensor) -> tuple[Tensor, Tensor]:
    """Which conics are positive definite, and whitening factors, 0 if not."""
    a, b, c = conics.double().unbind(-1)
    drawn = (c > 0) & (a * c > b * b)
    a, b, c = (torch.where(drawn, one, base) for one, base in ((a, 1.0), (b, 0.0), (c, 1.0)))
    factors = torch.stack([torch.sqrt(a - b * b / c), -b / c, torch.sqrt(c)], dim=-1)
    return drawn, torch.where(drawn[..., None], factors, 0.0).float()


def _lists(
    device: Device,
    size: tuple[int, int],
    count: int,
    packed: bool,
    flat: npt.NDArray[np.int64],
    offsets: npt.NDArray[np.int64],
    masks: npt.NDArray[np.bool_] | None,
) -> list[TileLists]:
    """The tile lists of every picture from gsplat's of all."""
    tiles = tile_count(*size)
    ends = np.append(offsets.ravel(), len(flat))
    if (np.diff(ends, prepend=0) < 0).any():
        raise ValueError(f"isect_offsets: {offsets.shape} does not rise from 0 to {len(flat)}")
    found = []
    for picture, first in enumerate(offsets.reshape(-1, tiles)):
        spans = np.diff(ends[picture * tiles : (picture + 1) * tiles + 1])
        gaussian = flat[first[0] : first[0] + spans.sum()] - (0 if packed else picture * count)
        if gaussian.size and not 0 <= gaussian.min() <= gaussian.max() < count:
            raise ValueError(f"flatten_ids: {flat.shape} has rows of another image")
        if masks is not None:
            shown = masks.reshape(-1, tiles)[picture]
            gaussian, spans = gaussian[np.repeat(shown, spans)], spans * shown
        row = np.empty(len(gaussian), np.int32)
        row[np.argsort(gaussian, kind="stable")] = np.arange(len(gaussian), dtype=np.int32)
        by_gaussian = np.bincount(gaussian, minlength=count)
        found.append(
            TileLists(
                size,
                device.upload(gaussian.astype(np.int32)),
                device.upload(row),
                device.upload(np.cumsum([0, *spans]).astype(np.int32)),
                device.upload(np.cumsum([0, *by_gaussian]).astype(np.int32)),
                device.upload(np.array([len(gaussian)], np.int64)),
            )
        )
    return found
