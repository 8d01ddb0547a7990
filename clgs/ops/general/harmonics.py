"""Colors of Gaussians from spherical harmonics of degree 0 to 4, by their direction from a camera.

With d the unit vector from the camera's centre to the mean, and Y the real harmonics:
    color = max(0, 1/2 + sum over c of sh[c] Y[c](d)), or, bare, the sum alone.
A mean in the centre has the direction 0, and no gradient.

Source: 3DGS (Kerbl et al. 2023), and its order and signs of the harmonics; degree 4: Sloan 2013.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_lanes
from clgs.shapes import Shapes


def forward(
    device: Device,
    mean: DeviceArray,
    sh: DeviceArray,
    camera: DeviceArray,
    degree: int,
    bare: bool = False,
) -> DeviceArray:
    """Colors (N, 3) float32.

    Args:
        device: where the arrays live.
        mean: (N, 3) float32, scene units.
        sh: (N, K, 3) float32, of which the first (degree + 1)^2 are used.
        camera: (26,) float32 as of ``Camera.pack``.
        degree: 0 to 4.
        bare: whether to leave out the shift by 1/2 and the limit 0.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(mean, sh, camera)
    color = device.empty((count, 3))
    device.run(
        device.kernel("views/harmonics", "harmonics_forward", **_defines(device, sh, degree, bare)),
        *by_lanes(device, count, device.lanes),
        mean=mean,
        sh=sh,
        camera=camera,
        count=np.int32(count),
        color=color,
    )
    return color


def backward(
    device: Device,
    mean: DeviceArray,
    sh: DeviceArray,
    camera: DeviceArray,
    degree: int,
    color: DeviceArray,
    d_color: DeviceArray,
    bare: bool = False,
) -> tuple[DeviceArray, DeviceArray]:
    """Gradients by the harmonics, (N, K, 3), and by the mean, (N, 3), which is minus the centre's.

    ``color`` is what :func:`forward` made of the arguments before it; ``d_color``: (N, 3) float32.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(mean, sh, camera)
    shapes = Shapes(N=count)
    shapes.check("color", color, "N 3", np.float32)
    shapes.check("d_color", d_color, "N 3", np.float32)
    every = (degree + 1) ** 2 == sh.shape[1]
    d_sh = device.empty(sh.shape) if every else device.zeros(sh.shape)
    d_mean = device.empty((count, 3))
    device.run(
        device.kernel(
            "views/harmonics", "harmonics_backward", **_defines(device, sh, degree, bare)
        ),
        *by_lanes(device, count, device.lanes),
        mean=mean,
        sh=sh,
        camera=camera,
        count=np.int32(count),
        color=color,
        d_color=d_color,
        d_sh=d_sh,
        d_mean=d_mean,
    )
    return d_sh, d_mean


def _defines(device: Device, sh: DeviceArray, degree: int, bare: bool) -> dict[str, int | float]:
    used = (degree + 1) ** 2
    if not 0 <= degree <= 4 or used > sh.shape[1]:
        raise ValueError(f"degree: {degree} needs {used} harmonics, and is 0 to 4; sh: {sh.shape}")
    rows = {"SH_ROWS": sh.shape[1], "BARE_SUMS": int(bare)}
    return {"VEC": device.lanes, "COEFFICIENTS": used, **rows}


def _check(mean: DeviceArray, sh: DeviceArray, camera: DeviceArray) -> int:
    """N; raises ValueError or TypeError if an array has the wrong shape or dtype."""
    shapes = Shapes()
    shapes.check("mean", mean, "N 3", np.float32)
    shapes.check("sh", sh, "N K 3", np.float32)
    shapes.check("camera", camera, "26", np.float32)
    return shapes.axes["N"]
