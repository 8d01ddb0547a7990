"""A pinhole camera in the OpenCV convention: x right, y down, z forward."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.constants import FRUSTUM_MARGIN

PACKED_SIZE = 26
"""Floats in a packed camera; ``kernels_cl/common/camera.h`` names them."""


@dataclass(frozen=True)
class Camera:
    """World-to-camera pose and intrinsics: x_cam = rotation @ x_world + translation.

    rotation (3, 3) float64, translation (3,) float64 in scene units; fx, fy, cx, cy in pixels,
    pixel centres at +0.5; width, height in pixels.
    """

    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def centre(self) -> npt.NDArray[np.float64]:
        """Camera centre (3,) float64 in scene units."""
        return -self.rotation.T @ self.translation

    def slope_limits(self) -> npt.NDArray[np.float64]:
        """(x_min, x_max, y_min, y_max): the limits of x/z and y/z in the Jacobian.

        The frame grown by FRUSTUM_MARGIN of its size on each side; for a centred principal point
        this is the +-1.3 tan(fov/2) of 3DGS.
        """
        margin_x, margin_y = FRUSTUM_MARGIN * self.width, FRUSTUM_MARGIN * self.height
        return np.array(
            [
                (-margin_x - self.cx) / self.fx,
                (self.width + margin_x - self.cx) / self.fx,
                (-margin_y - self.cy) / self.fy,
                (self.height + margin_y - self.cy) / self.fy,
            ]
        )

    def resized(self, width: int, height: int) -> Camera:
        """The same camera on a raster of another size; each axis by its own ratio."""
        x, y = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * x,
            cx=self.cx * x,
            fy=self.fy * y,
            cy=self.cy * y,
            width=width,
            height=height,
        )

    def reduced(self, factor: int) -> Camera:
        """The camera of a picture reduced ``factor`` times; sizes are rounded, at least 1."""
        if factor == 1:
            return self
        width, height = (max(1, round(size / factor)) for size in (self.width, self.height))
        return self.resized(width, height)

    def pack(self, near: float) -> npt.NDArray[np.float32]:
        """The camera as the kernels read it, (26,) float32; layout in common/camera.h."""
        return np.concatenate(
            [
                self.rotation.ravel(),
                self.translation,
                [self.fx, self.fy, self.cx, self.cy, self.width, self.height, near],
                self.slope_limits(),
                self.centre,
            ]
        ).astype(np.float32)
