"""Project neural Gaussians to the screen (EWA splatting, whitened form).

With p = R_view mean + t, u = x/z, v = y/z and the factor A = J R_view R(q) diag(scale) (2x3), the
blurred covariance is C = A A^T + BLUR I. Its whitening factor (r1, l, r2) gives
    y1 = dx * r1,   y2 = (dy - l * dx) * r2,   alpha = opacity * exp(-(y1^2 + y2^2) / 2),
    r1 = 1/sqrt(Cxx),   l = Cxy/Cxx,   r2 = sqrt(Cxx / det C).
In J, u and v are clamped to the frame grown by FRUSTUM_MARGIN; the backward pass honours the clamp.

Sources: 3DGS (EWA splatting, Zwicker et al. 2001); the whitened form is our own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device, round_up
from clgs.options import DEFAULT, RenderOptions
from clgs.shapes import Shapes

GROUP_SIZE = 64


@dataclass(frozen=True)
class Projected:
    """N Gaussians on the screen, float32; a culled Gaussian holds zeros.

    mean2d (N, 2) pixels, pixel centres at +0.5; whitening (N, 3) = r1, l, r2; depth (N,) camera z,
    scene units; extent (N, 2) pixels, half-widths of the box outside of which alpha < ALPHA_CUT:
    a Gaussian is drawn where extent > 0.
    """

    mean2d: DeviceArray
    whitening: DeviceArray
    depth: DeviceArray
    extent: DeviceArray


@dataclass(frozen=True)
class ProjectGradients:
    """Gradients of the loss: d_mean (N, 3), d_scale (N, 3), d_rotation (N, 4), float32."""

    d_mean: DeviceArray
    d_scale: DeviceArray
    d_rotation: DeviceArray


def forward(
    device: Device,
    mean: DeviceArray,
    scale: DeviceArray,
    rotation: DeviceArray,
    opacity: DeviceArray,
    camera: DeviceArray,
    options: RenderOptions = DEFAULT,
) -> Projected:
    """Project N Gaussians.

    Args:
        device: where the arrays live.
        mean: (N, 3) float32, scene units.
        scale: (N, 3) float32, scene units, positive.
        rotation: (N, 4) float32, unit quaternion w x y z; any other is culled.
        opacity: (N,) float32; below the alpha cut is culled.
        camera: (26,) float32 from ``Camera.pack``.
        options: accuracy, for the alpha cut and the smallest extent.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(mean, scale, rotation, camera)
    Shapes(N=count).check("opacity", opacity, "N", np.float32)
    result = allocate(device, count)
    device.run(
        device.kernel("gaussian/project", "project_forward", **defines(device, options)),
        (_items(device, count),),
        (GROUP_SIZE,),
        mean,
        scale,
        rotation,
        opacity,
        camera,
        np.int32(count),
        result.mean2d,
        result.whitening,
        result.depth,
        result.extent,
    )
    return result


def allocate(device: Device, count: int) -> Projected:
    """Room for ``count`` projections."""
    return Projected(
        mean2d=device.empty((count, 2)),
        whitening=device.empty((count, 3)),
        depth=device.empty((count,)),
        extent=device.empty((count, 2)),
    )


def backward(
    device: Device,
    gaussians: tuple[DeviceArray, DeviceArray, DeviceArray],
    camera: DeviceArray,
    projected: Projected,
    d_mean2d: DeviceArray,
    d_whitening: DeviceArray,
) -> ProjectGradients:
    """Gradients of the Gaussians from those of their projections; zero for culled ones.

    Args:
        device: where the arrays live.
        gaussians: mean (N, 3), scale (N, 3), rotation (N, 4), as given to :func:`forward`.
        camera: (26,) float32.
        projected: what :func:`forward` returned.
        d_mean2d: (N, 2) float32, per pixel.
        d_whitening: (N, 3) float32, by r1, l, r2.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    mean, scale, rotation = gaussians
    count = _check(mean, scale, rotation, camera)
    shapes = Shapes(N=count)
    shapes.check("d_mean2d", d_mean2d, "N 2", np.float32)
    shapes.check("d_whitening", d_whitening, "N 3", np.float32)
    result = ProjectGradients(
        d_mean=device.empty((count, 3)),
        d_scale=device.empty((count, 3)),
        d_rotation=device.empty((count, 4)),
    )
    device.run(
        device.kernel("gaussian/project", "project_backward", VEC=device.lanes),
        (_items(device, count),),
        (GROUP_SIZE,),
        mean,
        scale,
        rotation,
        camera,
        np.int32(count),
        projected.whitening,
        projected.extent,
        d_mean2d,
        d_whitening,
        result.d_mean,
        result.d_scale,
        result.d_rotation,
    )
    return result


def defines(device: Device, options: RenderOptions) -> dict[str, int | float]:
    """Build options of the kernels."""
    smallest = {"MIN_EXTENT": float(options.accuracy.min_extent)}
    return {"VEC": device.lanes, **smallest, **options.accuracy.defines()}


def _items(device: Device, count: int) -> int:
    """Work-items for ``count`` Gaussians, as many an item as a register has lanes."""
    return round_up(-(-count // device.lanes), GROUP_SIZE)


def _check(
    mean: DeviceArray, scale: DeviceArray, rotation: DeviceArray, camera: DeviceArray
) -> int:
    shapes = Shapes()
    shapes.check("mean", mean, "N 3", np.float32)
    shapes.check("scale", scale, "N 3", np.float32)
    shapes.check("rotation", rotation, "N 4", np.float32)
    shapes.check("camera", camera, "26", np.float32)
    return shapes.axes["N"]
