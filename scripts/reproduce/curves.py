"""Rate-distortion curves: how many bytes more or fewer one takes than another.

Bjontegaard's mean difference of rates (VCEG-M33), with a piecewise cubic interpolation that keeps
monotony (PCHIP) in place of one cubic through four points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

Curve = Sequence[tuple[float, float]]
"""Points (bytes, dB) in any order."""


class CurveError(ValueError):
    """Two curves cannot be compared; says why."""


def bd_rate(curve: Curve, baseline: Curve) -> float:
    """How many bytes more ``curve`` takes than ``baseline`` at equal PSNR: -0.5 is half of them.

    The mean of the difference of log bytes over the PSNRs that both curves reach, as a factor
    minus 1.

    Raises:
        CurveError: a curve has fewer than two points or two of the same PSNR, or they share no
            range of PSNRs.
    """
    first, second = _log_bytes(curve), _log_bytes(baseline)
    low = max(first.x[0], second.x[0])
    high = min(first.x[-1], second.x[-1])
    if not low < high:
        raise CurveError("the curves share no range of PSNRs")
    area = float(first.integrate(low, high)) - float(second.integrate(low, high))
    return float(np.expm1(area / (high - low)))


def rate_at(curve: Curve, point: tuple[float, float]) -> float:
    """How many bytes more ``curve`` takes than ``point`` at the point's PSNR: -0.5 is half of them.

    Raises:
        CurveError: the curve has fewer than two points, or does not reach that PSNR.
    """
    found, (size, psnr) = _log_bytes(curve), point
    if not found.x[0] <= psnr <= found.x[-1]:
        raise CurveError(f"the curve does not reach {psnr:.2f} dB")
    return float(np.expm1(float(found(psnr)) - np.log(size)))


def _log_bytes(curve: Curve) -> PchipInterpolator:
    """Log bytes by PSNR."""
    points = sorted((psnr, size) for size, psnr in curve)
    if len(points) < 2:
        raise CurveError(f"a curve needs two points; there is {len(points)}")
    psnr = np.array([point[0] for point in points])
    size = np.array([point[1] for point in points])
    if not (np.isfinite(psnr).all() and np.isfinite(size).all() and (size > 0).all()):
        raise CurveError("a point of a curve is no number of bytes and dB")
    if not (np.diff(psnr) > 0).all():
        raise CurveError("two points of a curve have the same PSNR")
    return PchipInterpolator(psnr, np.log(size))
