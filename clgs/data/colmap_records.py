"""What a COLMAP model holds, and the checks that its text and its binary form share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import numpy.typing as npt

MAX_COORDINATE = 1e12
"""Numbers beyond it are damage."""

MAX_IMAGE_SIDE = 1_000_000

PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
    "RAD_TAN_THIN_PRISM_FISHEYE": "fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3",
}
"""The parameters of each camera model, in COLMAP's order; binary files number the models so."""

Fail = Callable[[str], NoReturn]
"""Raises a DataError that names the file, the place in it, and the given problem."""


@dataclass(frozen=True)
class ColmapCamera:
    """COLMAP's name of the camera model, the image size in pixels, and the parameters."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def values(self) -> dict[str, float]:
        """The parameters by their names in PARAMETERS."""
        return dict(zip(PARAMETERS[self.model].split(), self.params, strict=True))

    def check(self, fail: Fail) -> None:
        """Call ``fail`` if no lens can have these numbers."""
        sides = self.width, self.height
        if not all(1 <= side <= MAX_IMAGE_SIDE for side in sides):
            fail(f"camera size {self.width}x{self.height} is impossible")
        if not all(abs(value) <= MAX_COORDINATE for value in self.params):
            fail(f"a camera parameter is not finite, or beyond {MAX_COORDINATE:g}")
        values = self.values()
        if not all(values[name] > 0 for name in ("f", "fx", "fy") if name in values):
            fail("focal length is not positive")


@dataclass(frozen=True)
class ColmapImage:
    """An image, its camera, and its pose from world to camera: w x y z, translation."""

    name: str
    camera: ColmapCamera
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]

    def rotation(self) -> npt.NDArray[np.float64]:
        """The rotation (3, 3), computed exactly as Eigen and so COLMAP does it."""
        w, x, y, z = self.quaternion
        x2, y2, z2 = 2 * x, 2 * y, 2 * z
        wx, wy, wz = x2 * w, y2 * w, z2 * w
        xx, xy, xz = x2 * x, y2 * x, z2 * x
        yy, yz, zz = y2 * y, z2 * y, z2 * z
        return np.array(
            [
                [1 - (yy + zz), xy - wz, xz + wy],
                [xy + wz, 1 - (xx + zz), yz - wx],
                [xz - wy, yz + wx, 1 - (xx + yy)],
            ]
        )


@dataclass(frozen=True)
class ColmapModel:
    """Images in file order; position (P, 3) float64 and color (P, 3) uint8 in order of ids."""

    images: list[ColmapImage]
    position: npt.NDArray[np.float64]
    color: npt.NDArray[np.uint8]


def check_pose(quaternion: tuple[float, ...], translation: tuple[float, ...], fail: Fail) -> None:
    """Call ``fail`` unless the pose is a rotation and a translation of sensible size."""
    # Readers do not scale the quaternion, so its length must be 1, except for rounding.
    if not math.isclose(math.hypot(*quaternion), 1.0, abs_tol=0.01):
        fail("QW, QX, QY, QZ are not of length 1")
    if not all(abs(value) <= MAX_COORDINATE for value in translation):
        fail(f"TX, TY, TZ are larger than {MAX_COORDINATE:g}")


def check_name(name: str, fail: Fail) -> None:
    """Call ``fail`` if an image name is empty or leads upwards."""
    if not name or ".." in name.replace("\\", "/").split("/"):
        fail(f"image name {name[:80]!r} must stay inside the images folder")


def sorted_points(
    number: npt.NDArray[np.integer],
    position: npt.NDArray[np.float64],
    color: npt.NDArray[np.uint8],
    fail: Fail,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    """Position (P, 3) and color (P, 3) in order of the ids (P,), of which each occurs once."""
    order = np.argsort(number, kind="stable")
    twice = np.flatnonzero(np.diff(number[order]) == 0)
    if len(twice):
        fail(f"point {number[order[twice[0]]]} occurs twice")
    return position[order], color[order]
