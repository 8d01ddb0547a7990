"""The Gaussians of a rendered view in the form in which gsplat takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.render.frame import Frame
from clgs.scene.camera import Camera

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class InSpace:
    """N Gaussians, float32.

    mean (N, 3), scale (N, 3): scene units; rotation (N, 4): unit quaternions w x y z; color (N, 3)
    and opacity (N,) in [0, 1].
    """

    mean: Floats
    scale: Floats
    rotation: Floats
    color: Floats
    opacity: Floats


@dataclass(frozen=True)
class OnScreen:
    """M Gaussians that touch the picture.

    mean (M, 2) float32: pixels, pixel centres at +0.5; conic (M, 3) float32: the inverse covariance
    as xx, xy, yy; radii (M, 2) int32: half-widths of the box that is looked at, pixels; depth (M,)
    float32: camera z; color (M, 3) and opacity (M,) float32.
    """

    mean: Floats
    conic: Floats
    radii: npt.NDArray[np.int32]
    depth: Floats
    color: Floats
    opacity: Floats


@dataclass(frozen=True)
class Handover:
    """A view: what is drawn, and the picture that clgs makes of it.

    viewmat (4, 4) and intrinsics (3, 3) float32: world to camera, and pixels; background (3,)
    float32; image (H, W, 3) float32.
    """

    space: InSpace
    screen: OnScreen
    viewmat: Floats
    intrinsics: Floats
    background: Floats
    image: Floats

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.image.shape[1], self.image.shape[0]


def hand_over(device: Device, frame: Frame, camera: Camera) -> Handover:
    """Copy what ``frame`` was made of, without padding; ``camera``: of the frame."""
    load = device.download
    gaussians, projected = frame.gaussians, frame.projected
    color, opacity, extent = load(gaussians.color), load(gaussians.opacity), load(projected.extent)
    there, drawn = opacity > 0, extent[:, 0] > 0
    space = InSpace(
        load(gaussians.mean)[there],
        load(gaussians.scale)[there],
        load(gaussians.rotation)[there],
        color[there],
        opacity[there],
    )
    screen = OnScreen(
        load(projected.mean2d)[drawn],
        conics(load(projected.whitening)[drawn]),
        np.ceil(extent[drawn]).astype(np.int32),
        load(projected.depth)[drawn],
        color[drawn],
        opacity[drawn],
    )
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3], viewmat[:3, 3] = camera.rotation, camera.translation
    intrinsics = np.array(
        [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float32
    )
    image = np.ascontiguousarray(load(frame.image).transpose(1, 2, 0))
    return Handover(space, screen, viewmat, intrinsics, load(frame.view.background), image)


def conics(whitening: Floats) -> Floats:
    """(M, 3) inverse covariances xx, xy, yy of whitening factors (M, 3) r1, l, r2.

    They are the coefficients of y1^2 + y2^2, see :mod:`clgs.ops.project`.
    """
    r1, shear, r2 = whitening.astype(np.float64).T
    xx, yy = r1**2 + (shear * r2) ** 2, r2**2
    return np.stack([xx, -shear * yy, yy], axis=1).astype(np.float32)
