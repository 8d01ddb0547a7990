"""Alpha blending in float64, written from the equations, tile by tile.

The decisions (which entries a pixel takes, where alpha saturates) are made here, or given: then
the result is smooth in all parameters, and comparable with kernels that decided otherwise by a
rounding error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT, ALPHA_MAX, TILE_SIZE, TRANSMITTANCE_STOP
from clgs.reference.project import Projected
from clgs.reference.tiles import TileLists

Array = npt.NDArray[np.float64]
Bits = npt.NDArray[np.bool_]

COLOR_LIMIT = 1e3


@dataclass(frozen=True)
class Decisions:
    """Per entry and pixel of its tile (row-major), bool (I, TILE_SIZE^2).

    contributed: the entry was blended into the pixel; saturated: with alpha at ALPHA_MAX.
    """

    contributed: Bits
    saturated: Bits


@dataclass(frozen=True)
class Truncation:
    """What a pixel leaves out.

    alpha_cut: entries with a smaller alpha; stop: the entry that brings the transmittance below it,
    which is still blended if ``inclusive``, and all behind.
    """

    alpha_cut: float = ALPHA_CUT
    stop: float = TRANSMITTANCE_STOP
    inclusive: bool = False


PARITY = Truncation()


@dataclass(frozen=True)
class Blended:
    """image (3, H, W), transmittance (H, W), and the decisions made.

    last_blended (H, W): entries of the pixel's list up to the last one that was blended. The op's
    ``last_contributor`` is at least that: it counts what the pixel saw before it was finished.
    """

    image: Array
    transmittance: Array
    last_blended: npt.NDArray[np.int64]
    decisions: Decisions


@dataclass(frozen=True)
class BlendGradients:
    """d_mean2d (N, 2), d_whitening (N, 3), d_color (N, 3), d_opacity (N,)."""

    d_mean2d: Array
    d_whitening: Array
    d_color: Array
    d_opacity: Array


@dataclass(frozen=True)
class _Tile:
    """One tile: n entries, p pixels inside the image."""

    entries: slice
    gaussian: npt.NDArray[np.int64]  # (n,)
    pixel: npt.NDArray[np.int64]  # (p,) number within the tile
    column: npt.NDArray[np.int64]  # (p,)
    row: npt.NDArray[np.int64]  # (p,)


@dataclass(frozen=True)
class _Layers:
    """What the entries do to the pixels of a tile, all (n, p)."""

    dx: Array
    dy: Array
    y1: Array
    y2: Array
    alpha: Array  # 0 if it does not contribute
    before: Array  # transmittance in front of the entry
    after: Array
    contributed: Bits
    saturated: Bits


def forward(
    projected: Projected,
    color: Array,
    opacity: Array,
    tiles: TileLists,
    background: Array,
    size: tuple[int, int],
    decisions: Decisions | None = None,
    truncation: Truncation = PARITY,
) -> Blended:
    """Render; arguments as in ``clgs.ops.blend.forward``; ``decisions`` replaces the own ones."""
    width, height = size
    count = len(tiles.gaussian), TILE_SIZE**2
    made = Decisions(np.zeros(count, bool), np.zeros(count, bool))
    image = np.zeros((3, height, width))
    transmittance = np.zeros((height, width))
    last = np.zeros((height, width), np.int64)
    for tile in _tiles(tiles, width, height):
        layers = _layers(tile, projected, opacity, decisions, truncation)
        weight = layers.alpha * layers.before
        left = layers.after[-1] if len(weight) else np.ones(len(tile.pixel))
        clamped = np.clip(color[tile.gaussian], -COLOR_LIMIT, COLOR_LIMIT)
        image[:, tile.row, tile.column] = clamped.T @ weight + background[:, None] * left
        transmittance[tile.row, tile.column] = left
        number = np.arange(1, len(weight) + 1)[:, None]
        last[tile.row, tile.column] = np.max(layers.contributed * number, axis=0, initial=0)
        made.contributed[tile.entries, tile.pixel] = layers.contributed
        made.saturated[tile.entries, tile.pixel] = layers.saturated & layers.contributed
    return Blended(image, transmittance, last, made)


def backward(
    projected: Projected,
    color: Array,
    opacity: Array,
    tiles: TileLists,
    background: Array,
    decisions: Decisions,
    d_image: Array,
) -> BlendGradients:
    """Gradients for given decisions, from d_image (3, H, W)."""
    height, width = d_image.shape[1:]
    count = len(opacity)
    result = BlendGradients(
        np.zeros((count, 2)), np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    )
    clamped = np.clip(color, -COLOR_LIMIT, COLOR_LIMIT)
    for tile in _tiles(tiles, width, height):
        layers = _layers(tile, projected, opacity, decisions)
        d_pixel = d_image[:, tile.row, tile.column]
        weight = layers.alpha * layers.before
        np.add.at(result.d_color, tile.gaussian, weight @ d_pixel.T)
        shade = clamped[tile.gaussian] @ d_pixel
        d_alpha = _alpha_gradient(layers, weight * shade, shade, background @ d_pixel)
        d_alpha = np.where(layers.contributed & ~layers.saturated, d_alpha, 0)
        _add_geometry(result, tile, projected, opacity, layers, d_alpha)
    result.d_color[np.abs(color) > COLOR_LIMIT] = 0
    return result


def _tiles(tiles: TileLists, width: int, height: int) -> Iterator[_Tile]:
    columns = -(-width // TILE_SIZE)
    y, x = (axis.ravel() for axis in np.mgrid[:TILE_SIZE, :TILE_SIZE])
    for number in range(len(tiles.tile_range) - 1):
        column, row = x + number % columns * TILE_SIZE, y + number // columns * TILE_SIZE
        pixel = np.flatnonzero((column < width) & (row < height))
        entries = slice(int(tiles.tile_range[number]), int(tiles.tile_range[number + 1]))
        yield _Tile(entries, tiles.gaussian[entries], pixel, column[pixel], row[pixel])


def _layers(
    tile: _Tile,
    projected: Projected,
    opacity: Array,
    decisions: Decisions | None,
    truncation: Truncation = PARITY,
) -> _Layers:
    dx = tile.column + 0.5 - projected.mean2d[tile.gaussian, 0, None]
    dy = tile.row + 0.5 - projected.mean2d[tile.gaussian, 1, None]
    r1, l_factor, r2 = projected.whitening[tile.gaussian].T[:, :, None]
    y1, y2 = dx * r1, (dy - l_factor * dx) * r2
    unclamped = opacity[tile.gaussian, None] * np.exp(-0.5 * (y1**2 + y2**2))
    if decisions is None:
        contributed, saturated = unclamped >= truncation.alpha_cut, unclamped >= ALPHA_MAX
        alpha = np.where(contributed, np.minimum(unclamped, ALPHA_MAX), 0)
        after = np.cumprod(1 - alpha, axis=0)
        # T never grows: once below the stop, it stays there
        crossing = np.concatenate([np.ones_like(after[:1]), after])[:-1]
        contributed &= (crossing if truncation.inclusive else after) >= truncation.stop
    else:
        contributed = decisions.contributed[tile.entries][:, tile.pixel]
        saturated = decisions.saturated[tile.entries][:, tile.pixel]
    alpha = np.where(contributed, np.where(saturated, ALPHA_MAX, unclamped), 0)
    after = np.cumprod(1 - alpha, axis=0)
    before = np.concatenate([np.ones((1, len(tile.pixel))), after])[:-1]
    return _Layers(dx, dy, y1, y2, alpha, before, after, contributed, saturated)


def _alpha_gradient(layers: _Layers, lit: Array, shade: Array, d_background: Array) -> Array:
    """dL/d(alpha) (n, p): an entry adds its own light and dims all behind, background included.

    ``lit`` is weight * shade, ``shade`` the colour dotted with d_image.
    """
    if not len(lit):
        return lit
    behind = np.cumsum(lit[::-1], axis=0)[::-1] - lit + d_background * layers.after[-1]
    return np.asarray(layers.before * shade - behind / (1 - layers.alpha))


def _add_geometry(
    result: BlendGradients,
    tile: _Tile,
    projected: Projected,
    opacity: Array,
    layers: _Layers,
    d_alpha: Array,
) -> None:
    """Chain rule on alpha = opacity exp(-(y1^2 + y2^2) / 2), y1 = dx r1, y2 = (dy - l dx) r2."""
    r1, l_factor, r2 = projected.whitening[tile.gaussian].T[:, :, None]
    d_y1 = -d_alpha * layers.alpha * layers.y1
    d_y2 = -d_alpha * layers.alpha * layers.y2
    d_mean2d = [-d_y1 * r1 + d_y2 * l_factor * r2, -d_y2 * r2]
    d_whitening = [
        d_y1 * layers.dx,
        -d_y2 * layers.dx * r2,
        d_y2 * (layers.dy - l_factor * layers.dx),
    ]
    for target, parts in ((result.d_mean2d, d_mean2d), (result.d_whitening, d_whitening)):
        np.add.at(target, tile.gaussian, np.sum(parts, axis=2).T)
    d_opacity = np.sum(d_alpha * layers.alpha, axis=1) / opacity[tile.gaussian]
    np.add.at(result.d_opacity, tile.gaussian, d_opacity)
