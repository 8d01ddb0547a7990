"""PSNR and SSIM between a render and a photo, in the forms that papers report.

Of a photo with a mask, ``used`` (H, W) of 0 and 1, both pictures are black where it is 0, and only
the pixels where it is 1 count.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.codec.workers import processors, workers
from clgs.constants import SSIM_C1, SSIM_C2, SSIM_SIGMA, SSIM_WINDOW
from clgs.errors import ClgsError
from clgs.shapes import Shapes

BAND = 64
"""Rows that a thread compares at once: what is computed of them stays in a processor's cache."""

MOST_THREADS = 8
"""Each takes some megabytes."""


def to_8bit(image: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    """The picture (H, W, 3) uint8 of a planar render (3, H, W).

    Clamped to [0, 1], times 255, rounded to the nearest integer, halves up: as
    ``torchvision.utils.save_image`` does, and exact for every k / 255 in float32.

    Raises:
        ClgsError: a pixel is not finite.
    """
    if not np.isfinite(image).all():
        raise ClgsError("render: a pixel is not finite; the scene holds broken numbers")
    levels = np.floor(np.clip(image, 0.0, 1.0) * 255.0 + 0.5)
    return np.ascontiguousarray(levels.astype(np.uint8).transpose(1, 2, 0))


Used = npt.NDArray[np.uint8] | None


def psnr_8bit(
    render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8], used: Used = None
) -> float:
    """-10 log10 of one MSE over all pixels and channels, data range 1, in dB.

    The literature's form. Both (H, W, 3) uint8; equal pictures give infinity.
    """
    shapes = Shapes()
    shapes.check("render", render, "H W 3", np.uint8)
    shapes.check("photo", photo, "H W 3", np.uint8)
    squared = np.square(render / 255.0 - photo / 255.0)
    return float(_decibel(_chosen(squared, used).mean()))


def blackened(picture: npt.NDArray[np.uint8], used: Used) -> npt.NDArray[np.uint8]:
    """The picture (H, W, 3) uint8, black where it is masked."""
    return picture if used is None else picture * used[..., None]


def _chosen(values: npt.NDArray[np.float64], used: Used) -> npt.NDArray[np.float64]:
    """Select the ``values`` (H, W, C) that count; (N, C) if there is a mask."""
    return values if used is None or not used.any() else values[used != 0]


def psnr_channel_mean(
    render: npt.NDArray[np.floating], photo: npt.NDArray[np.uint8], used: Used = None
) -> float:
    """Mean of the three channels' PSNRs on the unclamped render, in dB.

    The form of the reference code. render (3, H, W) float; photo (H, W, 3) uint8. Never below
    the PSNR of the mean MSE over channels.
    """
    shapes = Shapes()
    shapes.check("photo", photo, "H W 3", np.uint8)
    shapes.check("render", render, "3 H W", render.dtype)
    squared = np.square(render.astype(np.float64) - (photo / 255.0).transpose(2, 0, 1))
    if used is not None and used.any():
        return float(np.mean(_decibel(squared[:, used != 0].mean(axis=1))))
    return float(np.mean(_decibel(squared.mean(axis=(1, 2)))))


def ssim(render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8], used: Used = None) -> float:
    """Mean structural similarity over pixels and channels (Wang et al. 2004).

    11x11 Gaussian window of sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, data range 1,
    float64. Both (H, W, 3) uint8.
    """
    return float(_chosen(ssim_map(blackened(render, used), blackened(photo, used)), used).mean())


def ssim_map(
    render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8]
) -> npt.NDArray[np.float64]:
    """SSIM of every pixel and channel, (H, W, 3); :func:`ssim` is its mean."""
    shapes = Shapes()
    shapes.check("render", render, "H W 3", np.uint8)
    shapes.check("photo", photo, "H W 3", np.uint8)
    result, reach = np.empty(render.shape), SSIM_WINDOW // 2

    def fill(top: int) -> None:
        first, last = max(top - reach, 0), top + BAND + reach
        x, y = render[first:last] / 255.0, photo[first:last] / 255.0
        mean_x, mean_y = _blur(x), _blur(y)
        variance_x = _blur(x * x) - mean_x**2
        variance_y = _blur(y * y) - mean_y**2
        covariance = _blur(x * y) - mean_x * mean_y
        numerator = (2.0 * mean_x * mean_y + SSIM_C1) * (2.0 * covariance + SSIM_C2)
        denominator = (mean_x**2 + mean_y**2 + SSIM_C1) * (variance_x + variance_y + SSIM_C2)
        band = numerator / denominator
        result[top : top + BAND] = band[top - first : top - first + BAND]

    with workers(min(processors(), MOST_THREADS)) as pool:
        list(pool.map(fill, range(0, len(render), BAND)))
    return result


def _decibel(mse: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    with np.errstate(divide="ignore"):
        return np.asarray(-10.0 * np.log10(mse))


def _blur(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows and columns of (H, W, C) weighted by the window; zeros beyond the border."""
    from scipy.ndimage import correlate1d  # its 7 MiB would lie there while training

    distance = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    window = np.exp(-0.5 * (distance / SSIM_SIGMA) ** 2)
    window /= window.sum()
    for axis in (0, 1):
        image = correlate1d(image, window, axis=axis, mode="constant")
    return image
