"""Project neural Gaussians to the screen (EWA splatting, whitened form).

With p = R_view mean + t, u = x/z, v = y/z and the factor A = J R_view R(q) diag(scale) (2x3), the
blurred covariance is C = A A^T + BLUR I. Its whitening factor (r1, l, r2) gives
    y1 = dx * r1,   y2 = (dy - l * dx) * r2,   alpha = opacity * exp(-(y1^2 + y2^2) / 2),
    r1 = 1/sqrt(Cxx),   l = Cxy/Cxx,   r2 = sqrt(Cxx / det C).
In J, u and v are clamped to the frame grown by FRUSTUM_MARGIN; the backward pass honours the clamp.

Gaussians learn with BLUR, which is a part of what they show. If they are s times as large on the
screen as in the photos, they keep that blur, BLUR s^2. If they are smaller, s < 1, a pixel also
takes the mean over what it covers, and they give the light that they had:
    C = A A^T + BLUR s^2 I + max(1 - s^2, 0) PIXEL_VARIANCE I
    opacity' = opacity sqrt(det(A A^T + BLUR s^2 I) / det C)
:class:`Screen` has the bounds of the photos; training has no such bounds: s = 1.

Sources: 3DGS (EWA splatting, Zwicker et al. 2001); the whitened form is our own; Mip-Splatting (Yu
et al. 2024), section 4.2, for opacities; SA-GS (Song et al. 2024) for the blur at other sizes, with
bounds by all photos of our own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clgs.constants import BLUR
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_lanes
from clgs.ops.neural import GaussianGradients, Gaussians
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes


class Screen(NamedTuple):
    """What a picture needs to know of the photos from which its Gaussians were learned.

    x, y, z: a point, scene units; nearest, farthest: distances of the photos' cameras from it;
    enlarged: the focal length of the picture by that of the photos; all are zero if nothing is
    known. learned: the blur that Gaussians learned with, square pixels; with 0 that of the screen
    makes none brighter, as of antialiased splats. blur: that of the screen, square pixels.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    nearest: float = 0.0
    farthest: float = 0.0
    enlarged: float = 0.0
    learned: float = BLUR
    blur: float = BLUR


USUAL_SCREEN = Screen()
"""That of training, and of 3DGS."""

ANTIALIASED = Screen(learned=0.0)
"""That of splats which learned without a blur."""


@dataclass(frozen=True)
class Projected:
    """N Gaussians on the screen, float32; a culled Gaussian's first four fields are zeros.

    mean2d (N, 2) pixels, pixel centres at +0.5; whitening (N, 3) = r1, l, r2; depth (N,) camera z,
    scene units; extent (N, 2) pixels, half-widths of the box outside of which alpha < ALPHA_CUT:
    a Gaussian is drawn if extent > 0; color (N, 3) as in space; opacity (N,) on the screen.
    """

    mean2d: DeviceArray
    whitening: DeviceArray
    depth: DeviceArray
    extent: DeviceArray
    color: DeviceArray
    opacity: DeviceArray


@dataclass(frozen=True)
class ProjectedGradients:
    """Gradients of the loss, float32; zero for Gaussians that touch nothing.

    d_mean2d (N, 2) per pixel, d_whitening (N, 3), d_color (N, 3), d_opacity (N,).
    """

    d_mean2d: DeviceArray
    d_whitening: DeviceArray
    d_color: DeviceArray
    d_opacity: DeviceArray


def forward(
    device: Device,
    gaussians: Gaussians,
    camera: DeviceArray,
    options: RenderOptions = DEFAULT,
    screen: Screen = USUAL_SCREEN,
) -> Projected:
    """Project N Gaussians; ``camera``: (26,) float32 from ``Camera.pack``.

    A Gaussian is culled if its rotation is no unit quaternion, or its opacity is below the alpha
    cut of ``options.accuracy``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(gaussians, camera)
    result = allocate(device, gaussians.color, device.empty((count,)))
    device.run(
        device.kernel("gaussian/project", "project_forward", **defines(device, options)),
        *by_lanes(device, count, device.lanes),
        mean=gaussians.mean,
        scale=gaussians.scale,
        rotation=gaussians.rotation,
        opacity=gaussians.opacity,
        camera=camera,
        count=np.int32(count),
        screen=np.array(screen, np.float32),
        mean2d=result.mean2d,
        whitening=result.whitening,
        depth=result.depth,
        extent=result.extent,
        shown=result.opacity,
    )
    return result


def allocate(device: Device, color: DeviceArray, opacity: DeviceArray) -> Projected:
    """Room for the projections of Gaussians; ``color`` and ``opacity`` are theirs."""
    count = len(opacity)
    return Projected(
        mean2d=device.empty((count, 2)),
        whitening=device.empty((count, 3)),
        depth=device.empty((count,)),
        extent=device.empty((count, 2)),
        color=color,
        opacity=opacity,
    )


def backward(
    device: Device,
    gaussians: Gaussians,
    camera: DeviceArray,
    projected: Projected,
    d_projected: ProjectedGradients,
    antialiased: bool = False,
) -> GaussianGradients:
    """Gradients of the Gaussians from those of their projections; zero for culled ones.

    ``projected`` is what :func:`forward` made of ``gaussians`` and ``camera`` on the usual screen,
    or on that of ``antialiased`` ones; ``d_projected`` has the gradients by its fields. Those by
    color are passed through.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(gaussians, camera)
    shapes = Shapes(N=count)
    shapes.check("d_mean2d", d_projected.d_mean2d, "N 2", np.float32)
    shapes.check("d_whitening", d_projected.d_whitening, "N 3", np.float32)
    shapes.check("d_opacity", d_projected.d_opacity, "N", np.float32)
    result = GaussianGradients(
        d_mean=device.empty((count, 3)),
        d_scale=device.empty((count, 3)),
        d_rotation=device.empty((count, 4)),
        d_color=d_projected.d_color,
        d_opacity=device.empty((count,)),
    )
    device.run(
        device.kernel("gaussian/project", "project_backward", VEC=device.lanes),
        *by_lanes(device, count, device.lanes),
        mean=gaussians.mean,
        scale=gaussians.scale,
        rotation=gaussians.rotation,
        camera=camera,
        count=np.int32(count),
        antialiased=np.int32(antialiased),
        opacity=gaussians.opacity,
        whitening=projected.whitening,
        extent=projected.extent,
        d_mean2d=d_projected.d_mean2d,
        d_whitening=d_projected.d_whitening,
        d_shown=d_projected.d_opacity,
        d_mean=result.d_mean,
        d_scale=result.d_scale,
        d_rotation=result.d_rotation,
        d_opacity=result.d_opacity,
    )
    return result


def defines(device: Device, options: RenderOptions) -> dict[str, int | float]:
    """Build options of the kernels."""
    smallest = {"MIN_EXTENT": float(options.accuracy.min_extent)}
    return {"VEC": device.lanes, **smallest, **options.accuracy.defines()}


def _check(gaussians: Gaussians, camera: DeviceArray) -> int:
    """N; raises ValueError or TypeError if an array has the wrong shape or dtype."""
    shapes = Shapes()
    shapes.check("mean", gaussians.mean, "N 3", np.float32)
    shapes.check("scale", gaussians.scale, "N 3", np.float32)
    shapes.check("rotation", gaussians.rotation, "N 4", np.float32)
    shapes.check("opacity", gaussians.opacity, "N", np.float32)
    shapes.check("camera", camera, "26", np.float32)
    return shapes.axes["N"]
