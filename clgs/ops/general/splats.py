"""Ordinary Gaussians as a camera sees them: what 3DGS stores to what is projected, and back.

With d the unit vector from the camera's centre to the mean m, and Y the real spherical harmonics
up to the degree of the coefficients:
    scale = exp(log scale),   rotation = q / |q|,   opacity = 1 / (1 + exp(-logit)),
    color = max(0, 1/2 + sum over c of sh[c] Y[c](d)).
Log scales are clamped to +-LOG_SCALE_LIMIT, with gradient zero outside; a quaternion without
direction gives the rotation 0, which projection culls. The gradient by the mean includes that of
the color through d.

Source: 3DGS (Kerbl et al. 2023), and its order and signs of the harmonics.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_lanes
from clgs.ops.neural import GaussianGradients, Gaussians
from clgs.scene.gaussians import SPECS, DeviceGaussians, OrdinaryGaussians
from clgs.shapes import Shapes


def forward(device: Device, stored: DeviceGaussians, camera: DeviceArray) -> Gaussians:
    """The N Gaussians of ``stored``, float32, with the colors that a camera sees.

    ``camera``: (26,) float32 from ``Camera.pack``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(stored, camera)
    result = Gaussians(
        mean=stored.mean,
        scale=device.empty((count, 3)),
        rotation=device.empty((count, 4)),
        color=device.empty((count, 3)),
        opacity=device.empty((count,)),
    )
    device.run(
        device.kernel("gaussian/splats", "splats_forward", **_defines(device, stored)),
        *by_lanes(device, count, device.lanes),
        mean=stored.mean,
        log_scale=stored.log_scale,
        rotation=stored.rotation,
        logit=stored.opacity,
        sh=stored.sh,
        camera=camera,
        count=np.int32(count),
        scale=result.scale,
        unit=result.rotation,
        color=result.color,
        opacity=result.opacity,
    )
    return result


def backward(
    device: Device,
    stored: DeviceGaussians,
    camera: DeviceArray,
    seen: Gaussians,
    d_seen: GaussianGradients,
) -> DeviceGaussians:
    """Gradients by the arrays of ``stored``, in the same record.

    ``seen`` is what :func:`forward` made of ``stored`` and ``camera``, ``d_seen`` has the gradients
    by its fields; ``d_mean`` is overwritten and becomes part of the result.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(stored, camera)
    shapes = Shapes(N=count)
    widths = {"d_mean": "N 3", "d_scale": "N 3", "d_rotation": "N 4", "d_color": "N 3"}
    for name, spec in {**widths, "d_opacity": "N"}.items():
        shapes.check(name, getattr(d_seen, name), spec, np.float32)
    result = OrdinaryGaussians(
        mean=d_seen.d_mean,
        log_scale=device.empty((count, 3)),
        rotation=device.empty((count, 4)),
        opacity=device.empty((count,)),
        sh=device.empty(stored.sh.shape),
    )
    device.run(
        device.kernel("gaussian/splats", "splats_backward", **_defines(device, stored)),
        *by_lanes(device, count, device.lanes),
        mean=stored.mean,
        log_scale=stored.log_scale,
        rotation=stored.rotation,
        sh=stored.sh,
        camera=camera,
        count=np.int32(count),
        scale=seen.scale,
        color=seen.color,
        opacity=seen.opacity,
        d_scale=d_seen.d_scale,
        d_unit=d_seen.d_rotation,
        d_color=d_seen.d_color,
        d_opacity=d_seen.d_opacity,
        d_mean=result.mean,
        d_log_scale=result.log_scale,
        d_rotation=result.rotation,
        d_logit=result.opacity,
        d_sh=result.sh,
    )
    return result


def _defines(device: Device, stored: DeviceGaussians) -> dict[str, int | float]:
    return {"VEC": device.lanes, "COEFFICIENTS": stored.sh.shape[1]}


def _check(stored: DeviceGaussians, camera: DeviceArray) -> int:
    """N; raises ValueError or TypeError if an array has the wrong shape or dtype."""
    shapes = Shapes()
    for name, array in stored.items():
        shapes.check(name, array, SPECS[name], np.float32)
    shapes.check("camera", camera, "26", np.float32)
    return len(stored)
