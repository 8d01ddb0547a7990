"""Lenses: pinhole intrinsics with distortion, and the map that takes the distortion out.

Models: OpenCV's rational radial-tangential model and its equidistant fisheye, which between them
contain COLMAP's and nerfstudio's usual camera models. Pixel centres are at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from threading import Lock

import numpy as np
import numpy.typing as npt

from clgs.data.images import Pixels
from clgs.data.reduction import VIEWS
from clgs.errors import DataError

Floats = npt.NDArray[np.float64]

_MAX_ANGLE = np.radians(VIEWS[1] / 2)
"""A fisheye ray further from the axis has no place in a pinhole image of sensible size."""

_ROUNDS = 25
"""Fixed-point steps that take the tangential distortion of a fisheye out."""

_BAND_PIXELS = 65_536
"""Pixels resampled at a time, so that the work stays in the cache."""

_ALIKE, _OFF = 0.02, 0.2
"""Shares of the sides of a raster: its centre is that of another raster if its places along both
are alike within the one and off the middle by more than the other.
"""

_one_at_a_time = Lock()
"""Held while sources are computed, so that threads wait for them instead of repeating the work."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics in pixels of a width x height raster, and distortion coefficients.

    radial: up to four coefficients of r^2, r^4, r^6, r^8 (of theta for a fisheye); divisor: the
    same for the denominator; tangential: p1, p2; skew: x grows by this times y, after the
    distortion; view: degrees that the undistorted picture of a fisheye shows at most, across and
    down; 0: as many as it holds.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    radial: tuple[float, ...] = ()
    divisor: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    fisheye: bool = False
    skew: float = 0.0
    view: float = 0.0

    @classmethod
    def of_model(
        cls,
        model: str,
        size: tuple[int, int],
        focal: tuple[float, float],
        centre: tuple[float, float],
        coefficients: dict[str, float],
    ) -> Lens:
        """The lens of a COLMAP camera model.

        Args:
            model: COLMAP's name of it.
            size: (width, height) in pixels.
            focal: in x and y, pixels.
            centre: the principal point, pixels.
            coefficients: k1 to k6, p1, p2; those that are missing are 0.
        """
        k = [coefficients.get(f"k{i}", 0.0) for i in range(1, 7)]
        full = model == "FULL_OPENCV"
        radial, divisor = (k[:3], k[3:]) if full else (k[:4], [])
        tangential = coefficients.get("p1", 0.0), coefficients.get("p2", 0.0)
        fisheye = "FISHEYE" in model
        return cls(*size, *focal, *centre, tuple(radial), tuple(divisor), tangential, fisheye)

    @property
    def distorted(self) -> bool:
        """Whether the lens differs from a pinhole."""
        return self.fisheye or any((*self.radial, *self.divisor, *self.tangential, self.skew))

    @property
    def is_of_another_size(self) -> bool:
        """Whether the principal point is that of a raster of another size.

        It then lies outside, or far from the middle by the same share of the width and the height.
        """
        x, y = self.cx / self.width, self.cy / self.height
        return not self.holds_its_centre or (abs(x - y) < _ALIKE and abs(x - 0.5) > _OFF)

    @property
    def holds_its_centre(self) -> bool:
        """Whether the principal point lies in the raster."""
        return 0 <= self.cx <= self.width and 0 <= self.cy <= self.height

    def resized(self, width: int, height: int) -> Lens:
        """The same lens on a raster of another size; each axis by its own ratio."""
        x, y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * x,
            cx=self.cx * x,
            fy=self.fy * y,
            cy=self.cy * y,
        )

    def distort(self, points: Floats) -> Floats:
        """Ideal image-plane points (N, 2) = (x/z, y/z) as the lens distorts them, (N, 2)."""
        if self.fisheye:
            radius = np.hypot(points[:, 0], points[:, 1])
            points = points * (np.arctan(radius) / np.maximum(radius, 1e-12))[:, None]
        x, y = points.T
        square = x * x + y * y
        radial = _polynomial(self.radial, square) / _polynomial(self.divisor, square)
        p1, p2 = self.tangential
        bent_y = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x) + self.skew * bent_y
        return np.stack([bent_x, bent_y], axis=1)

    def undistort(self, points: Floats) -> Floats:
        """The inverse of ``distort`` by damped Newton steps, (N, 2) to (N, 2) float64.

        Raises:
            DataError: the model cannot be inverted within the image.
        """
        if self.fisheye:
            return self._undistort_fisheye(points - np.outer(points[:, 1], (self.skew, 0.0)))
        current = points.copy()
        for _ in range(50):
            error = self.distort(current) - points
            if np.abs(error).max(initial=0.0) < 1e-12:
                break
            columns = [  # central differences
                (self.distort(current + offset) - self.distort(current - offset)) / 2e-6
                for offset in np.eye(2) * 1e-6
            ]
            jacobian = np.stack(columns, axis=2)
            current -= np.clip(_solve_2x2(jacobian, error), -0.25, 0.25)
        if not np.abs(self.distort(current) - points).max(initial=0.0) < 1e-7:
            raise DataError("the distortion coefficients cannot be undone inside the image")
        return current

    def _undistort_fisheye(self, points: Floats) -> Floats:
        """The same for a fisheye without skew: rays beyond _MAX_ANGLE end there."""
        plane, (p1, p2) = points, self.tangential
        for _ in range(_ROUNDS if any(self.tangential) else 1):
            (x, y), square = plane.T, (plane**2).sum(axis=1)
            shift_x = 2 * p1 * x * y + p2 * (square + 2 * x * x)
            shift_y = p1 * (square + 2 * y * y) + 2 * p2 * x * y
            straight = points - np.stack([shift_x, shift_y], axis=1)
            bent = np.hypot(straight[:, 0], straight[:, 1])
            angle = _invert_polynomial(self.radial, bent)
            plane = straight * (angle / np.maximum(bent, 1e-12))[:, None]
        angle = np.hypot(plane[:, 0], plane[:, 1])
        longer = np.tan(np.minimum(angle, _MAX_ANGLE)) / np.maximum(angle, 1e-12)
        return plane * longer[:, None]


@lru_cache(maxsize=256)
def undistort_lens(lens: Lens) -> tuple[Lens, tuple[int, int]]:
    """The pinhole lens of the undistorted image, and the (x, y) of its corner.

    Focal lengths stay; the raster is the largest upright rectangle between the undistorted borders,
    so that every pixel has a source. At most twice as large as the input, and of a fisheye no wider
    than its ``view``.
    """
    if not lens.distorted:
        return lens, (0, 0)
    left, right = _border(lens, 0, 0.0).max(), _border(lens, 0, 1.0).min()
    top, bottom = _border(lens, 1, 0.0).max(), _border(lens, 1, 1.0).min()
    if lens.fisheye and lens.view:
        across, down = np.tan(np.radians(lens.view / 2)) * np.array([lens.fx, lens.fy])
        left, right = max(left, lens.cx - across), min(right, lens.cx + across)
        top, bottom = max(top, lens.cy - down), min(bottom, lens.cy + down)
    x0 = int(np.ceil(max(left, -0.5 * lens.width) - 1e-9))
    x1 = int(np.floor(min(right, 1.5 * lens.width) + 1e-9))
    y0 = int(np.ceil(max(top, -0.5 * lens.height) - 1e-9))
    y1 = int(np.floor(min(bottom, 1.5 * lens.height) + 1e-9))
    if not (x1 > x0 and y1 > y0):
        raise DataError("the distortion coefficients leave no valid pixel")
    pinhole = Lens(x1 - x0, y1 - y0, lens.fx, lens.fy, lens.cx - x0, lens.cy - y0)
    return pinhole, (x0, y0)


def undistort_pixels(pixels: Pixels, lens: Lens) -> Pixels:
    """Bilinear resampling to the pinhole image of ``undistort_lens``; color and alpha alike."""
    if not lens.distorted:
        return pixels
    pinhole, _ = undistort_lens(lens)
    with _one_at_a_time:
        found = sources(lens)
    result = resample(pixels.channels, *found)
    return Pixels.of(result.reshape(pinhole.height, pinhole.width, -1))


@lru_cache(maxsize=2)  # 12 bytes per pixel
def sources(lens: Lens) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
    """The flat index (N,) of the upper left source pixel of each output pixel, and the weights.

    Weights (N, 2) in x and y; positions are clamped so that the lower right neighbour exists.
    """
    pinhole, _ = undistort_lens(lens)
    index = np.empty(pinhole.width * pinhole.height, np.int32)
    weight = np.empty((len(index), 2), np.float32)
    limit = np.array([lens.width - 1, lens.height - 1])
    columns = (np.arange(pinhole.width) + 0.5 - pinhole.cx) / lens.fx
    for row in range(pinhole.height):
        y = np.full(pinhole.width, (row + 0.5 - pinhole.cy) / lens.fy)
        bent = lens.distort(np.stack([columns, y], axis=1))
        source = bent * (lens.fx, lens.fy) + (lens.cx - 0.5, lens.cy - 0.5)
        source = np.clip(source, 0, limit)
        corner = np.minimum(source.astype(np.int32), np.maximum(limit - 1, 0))
        part = slice(row * pinhole.width, (row + 1) * pinhole.width)
        index[part] = corner[:, 1] * lens.width + corner[:, 0]
        weight[part] = source - corner
    return index, weight


def resample(
    image: npt.NDArray[np.uint8], index: npt.NDArray[np.int32], weight: npt.NDArray[np.float32]
) -> npt.NDArray[np.uint8]:
    """Bilinear samples (N, C) uint8 of an image (H, W, C).

    Args:
        image: is sampled.
        index: (N,) flat, of the upper left one of the four pixels of each sample.
        weight: (N, 2) of the right and the lower ones.
    """
    height, width, channels = image.shape
    planes = np.ascontiguousarray(image.reshape(-1, channels).T)
    right, below = int(width > 1), width * int(height > 1)
    result = np.empty((channels, len(index)), np.uint8)
    for start in range(0, len(index), _BAND_PIXELS):
        part = slice(start, start + _BAND_PIXELS)
        at, (x, y) = index[part].astype(np.intp), np.ascontiguousarray(weight[part].T)
        for plane, values in zip(planes, result, strict=True):
            upper = _between(plane[at], plane[at + right], x)
            lower = _between(plane[at + below], plane[at + below + right], x)
            values[part] = np.rint(upper + (lower - upper) * y)
    return np.ascontiguousarray(result.T)


def _between(
    first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8], weight: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    return first + (second - first.astype(np.float32)) * weight


def _border(lens: Lens, axis: int, side: float) -> Floats:
    """Undistorted pixel coordinates along ``axis`` of one border of the image."""
    size = np.array([lens.width, lens.height], np.float64)
    steps = np.linspace(0.0, 1.0, 129)
    pixels = np.empty((len(steps), 2))
    pixels[:, axis] = side * size[axis]
    pixels[:, 1 - axis] = steps * size[1 - axis]
    focal, centre = np.array([lens.fx, lens.fy]), np.array([lens.cx, lens.cy])
    ideal = lens.undistort((pixels - centre) / focal)
    return np.asarray((ideal * focal + centre)[:, axis])


def _polynomial(coefficients: tuple[float, ...], x: Floats) -> Floats:
    result = np.zeros_like(x)
    for coefficient in reversed(coefficients):
        result = (result + coefficient) * x
    return 1.0 + result


def _invert_polynomial(coefficients: tuple[float, ...], bent: Floats) -> Floats:
    """The angle (N,) whose bent angle theta * poly(theta^2) is given: table, then Newton steps."""
    grid = np.linspace(0.0, np.pi / 2, 4097)
    values = grid * _polynomial(coefficients, grid**2)
    falling = np.flatnonzero(np.diff(values) <= 0)
    rising = slice(0, falling[0] + 1 if len(falling) else len(grid))
    angle = np.interp(bent, values[rising], grid[rising])
    for _ in range(5):
        error = angle * _polynomial(coefficients, angle**2) - bent
        slope = np.interp(angle, grid, np.gradient(values, grid))
        angle = angle - np.where(slope > 0.05, error / np.maximum(slope, 0.05), 0.0)
    return np.clip(angle, 0.0, np.pi / 2)


def _solve_2x2(matrix: Floats, right: Floats) -> Floats:
    """Solutions (N, 2) of matrix (N, 2, 2) @ x = right (N, 2); singular ones give a zero step."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    determinant = a * d - b * c
    safe = np.where(np.abs(determinant) > 1e-12, determinant, np.inf)
    x = (d * right[:, 0] - b * right[:, 1]) / safe
    y = (a * right[:, 1] - c * right[:, 0]) / safe
    return np.stack([x, y], axis=1)
