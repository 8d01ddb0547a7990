"""Blending of any number of channels in float64, every Gaussian over every pixel, without tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT, TRANSMITTANCE_STOP
from clgs.reference.project import Projected

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Layers:
    """Drawn Gaussians, front to back, over P pixels.

    order (n,): their numbers; y1, y2, alpha (0 if not blended), before (the transmittance in front)
    (n, P); free: blended with an alpha below the largest.
    """

    order: npt.NDArray[np.int64]
    y1: Array
    y2: Array
    alpha: Array
    before: Array
    free: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ChannelGradients:
    """Fields of ``clgs.ops.general.channels.ChannelGradients``; d_channel has the depth's last."""

    d_mean2d: Array
    d_whitening: Array
    d_opacity: Array
    d_channel: Array
    d_absolute: Array


def layers(projected: Projected, opacity: Array, size: tuple[int, int], alpha_max: float) -> Layers:
    """What each Gaussian does to each pixel of a picture of ``size``, width and height."""
    drawn = np.flatnonzero(projected.extent[:, 0] > 0)
    order = drawn[np.argsort(projected.depth[drawn], kind="stable")]
    y, x = (axis.ravel() + 0.5 for axis in np.mgrid[: size[1], : size[0]])
    dx = x - projected.mean2d[order, 0, None]
    dy = y - projected.mean2d[order, 1, None]
    r1, l_factor, r2 = projected.whitening[order].T[:, :, None]
    y1, y2 = dx * r1, (dy - l_factor * dx) * r2
    unclamped = opacity[order, None] * np.exp(-0.5 * (y1**2 + y2**2))
    alpha = np.where(unclamped >= ALPHA_CUT, np.minimum(unclamped, alpha_max), 0.0)
    # T never grows: once below the stop, it stays there
    alpha = np.where(np.cumprod(1 - alpha, axis=0) >= TRANSMITTANCE_STOP, alpha, 0.0)
    before = np.concatenate([np.ones((1, alpha.shape[1])), np.cumprod(1 - alpha, axis=0)])[:-1]
    return Layers(order, y1, y2, alpha, before, (alpha > 0) & (unclamped < alpha_max))


def forward(
    made: Layers, channel: Array, background: Array, size: tuple[int, int]
) -> tuple[Array, Array]:
    """Image (H, W, C) and transmittance (H, W) of Gaussians with channels (N, C)."""
    rest = np.prod(1 - made.alpha, axis=0)
    image = (made.alpha * made.before).T @ channel[made.order] + rest[:, None] * background
    return image.reshape(size[1], size[0], -1), rest.reshape(size[1], size[0])


def backward(
    made: Layers,
    projected: Projected,
    opacity: Array,
    channel: Array,
    background: Array,
    d_image: Array,
    d_left: Array,
) -> ChannelGradients:
    """Gradients from those of the image (H, W, C) and of the transmittance (H, W)."""
    count, order = len(opacity), made.order
    d_pixel = d_image.reshape(-1, d_image.shape[2])
    weight = made.alpha * made.before
    shade = channel[order] @ d_pixel.T
    d_rest = (d_pixel @ background + d_left.ravel()) * np.prod(1 - made.alpha, axis=0)
    lit = weight * shade
    behind = np.cumsum(lit[::-1], axis=0)[::-1] - lit + d_rest
    d_alpha = np.where(made.free, made.before * shade - behind / (1 - made.alpha), 0.0)
    v = made.alpha * d_alpha
    r1, l_factor, r2 = projected.whitening[order].T[:, :, None]
    along_x, along_y = v * (made.y1 * r1 - made.y2 * l_factor * r2), v * made.y2 * r2
    whitening = [
        -v * made.y1**2 / r1,
        v * made.y1 * made.y2 * r2 / r1,
        -v * made.y2**2 / r2,
    ]
    result = ChannelGradients(
        np.zeros((count, 2)),
        np.zeros((count, 3)),
        np.zeros(count),
        np.zeros((count, channel.shape[1])),
        np.zeros((count, 2)),
    )
    result.d_mean2d[order] = np.sum([along_x, along_y], axis=2).T
    result.d_absolute[order] = np.sum(np.abs([along_x, along_y]), axis=2).T
    result.d_whitening[order] = np.sum(whitening, axis=2).T
    result.d_opacity[order] = v.sum(axis=1) / opacity[order]
    result.d_channel[order] = weight @ d_pixel
    return result
