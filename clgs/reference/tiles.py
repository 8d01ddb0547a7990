"""Lists of the Gaussians in every tile, by asking every tile about every Gaussian, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT, TILE_SIZE
from clgs.reference.project import Projected

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class TileLists:
    """The fields of ``clgs.ops.tiles.TileLists``: gaussian, row, tile_range, row_range."""

    gaussian: Index
    row: Index
    tile_range: Index
    row_range: Index


def forward(projected: Projected, opacity: Array, width: int, height: int) -> TileLists:
    """The lists of Gaussians with alpha >= ALPHA_CUT somewhere among a tile's pixel centres.

    "Among": in the rectangle that the centres span.
    """
    drawn = np.flatnonzero(projected.extent[:, 0] > 0)
    order = drawn[np.argsort(projected.depth[drawn], kind="stable")]
    hits = [
        tiles_of(projected.mean2d[i], projected.whitening[i], opacity[i], (width, height))
        for i in order
    ]
    counts = np.zeros(len(opacity), np.int64)
    counts[order] = [len(tiles) for tiles in hits]
    row_range = np.concatenate([[0], np.cumsum(counts)])
    tile = np.concatenate([*hits, np.empty(0, np.int64)])
    by_tile = np.argsort(tile, kind="stable")
    rows = [row_range[i] + np.arange(counts[i]) for i in order]
    tiles = -(-width // TILE_SIZE) * -(-height // TILE_SIZE)
    return TileLists(
        gaussian=np.repeat(order, counts[order])[by_tile],
        row=np.concatenate([*rows, np.empty(0, np.int64)])[by_tile],
        tile_range=np.searchsorted(tile[by_tile], np.arange(tiles + 1)),
        row_range=row_range,
    )


def tiles_of(mean2d: Array, whitening: Array, opacity: float, size: tuple[int, int]) -> Index:
    """Numbers of the tiles that one Gaussian reaches, ascending; pixels outside do not count."""
    columns, rows = -(-size[0] // TILE_SIZE), -(-size[1] // TILE_SIZE)
    left = np.tile(np.arange(columns) * TILE_SIZE, rows) + 0.5 - mean2d[0]
    top = np.repeat(np.arange(rows) * TILE_SIZE, columns) + 0.5 - mean2d[1]
    right = np.minimum(left + TILE_SIZE - 1, size[0] - 0.5 - mean2d[0])
    bottom = np.minimum(top + TILE_SIZE - 1, size[1] - 0.5 - mean2d[1])
    inside = (left <= 0) & (right >= 0) & (top <= 0) & (bottom >= 0)
    smallest = np.where(inside, 0.0, np.inf)
    r1, l_factor, r2 = whitening
    for x in (left, right):  # the derivative by dy vanishes at l dx
        y = np.clip(l_factor * x, top, bottom)
        smallest = np.minimum(smallest, _squared(x, y, whitening))
    for y in (top, bottom):  # from the derivative by dx
        best = y * l_factor * r2**2 / (r1**2 + (l_factor * r2) ** 2)
        smallest = np.minimum(smallest, _squared(np.clip(best, left, right), y, whitening))
    return np.flatnonzero(opacity * np.exp(-0.5 * smallest) >= ALPHA_CUT)


def _squared(dx: Array, dy: Array, whitening: Array) -> Array:
    r1, l_factor, r2 = whitening
    return np.asarray((dx * r1) ** 2 + ((dy - l_factor * dx) * r2) ** 2)
