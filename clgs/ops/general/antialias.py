"""Opacities of Gaussians whose blur on the screen must not make them brighter.

With the covariance C of a Gaussian on the screen and the blurred one C + BLUR I,
    opacity' = opacity * sqrt(det C / det(C + BLUR I)).
A Gaussian that is small on the screen keeps the light that it has, spread over more pixels. There
is no backward pass: nothing is trained so.

Source: Mip-Splatting (Yu et al. 2024), section 4.2, with the blur of 3DGS.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_lanes
from clgs.ops.neural import Gaussians
from clgs.shapes import Shapes


def forward(device: Device, gaussians: Gaussians, camera: DeviceArray) -> Gaussians:
    """The N Gaussians with the opacities that they have for a camera.

    Args:
        device: where the arrays live.
        gaussians: with unit quaternions.
        camera: (26,) float32 from ``Camera.pack``.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    for name, spec in {"mean": "N 3", "scale": "N 3", "rotation": "N 4", "opacity": "N"}.items():
        shapes.check(name, getattr(gaussians, name), spec, np.float32)
    shapes.check("camera", camera, "26", np.float32)
    count = shapes.axes["N"]
    compensated = device.empty((count,))
    device.run(
        device.kernel("gaussian/antialias", "antialias_forward", VEC=device.lanes),
        *by_lanes(device, count, device.lanes),
        mean=gaussians.mean,
        scale=gaussians.scale,
        rotation=gaussians.rotation,
        opacity=gaussians.opacity,
        camera=camera,
        count=np.int32(count),
        compensated=compensated,
    )
    return replace(gaussians, opacity=compensated)
