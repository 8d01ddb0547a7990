"""Project Gaussians for any camera, with gradients by Gaussians and camera.

As ``clgs.ops.project``, and more general: shapes are unnormalised quaternions with scales, or
covariances; the camera's 3x4 matrix need not be a rotation; rays may be parallel, or those of an
equidistant fisheye; blur, far plane and smallest radius are arguments; opacities can make up for
the blur, with a gradient. Trainers with one kind of camera keep the faster stage.

Sources: 3DGS (EWA splatting, Zwicker et al. 2001); Mip-Splatting (Yu et al. 2024) for the
opacities; gradients by the camera are our own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import FRUSTUM_MARGIN
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_lanes
from clgs.ops.general.channels import ChannelGradients
from clgs.ops.project import Projected
from clgs.options import RenderOptions
from clgs.shapes import Shapes


@dataclass(frozen=True)
class Splats:
    """N Gaussians, float32: mean (N, 3), opacity (N,), and their shapes.

    shape: scales (N, 3), with rotation (N, 4), quaternions w x y z of any length above 0; or
    covariances (N, 6), xx, xy, xz, yy, yz, zz, with rotation None.
    """

    mean: DeviceArray
    shape: DeviceArray
    rotation: DeviceArray | None
    opacity: DeviceArray

    def __len__(self) -> int:
        return self.mean.shape[0]


@dataclass(frozen=True)
class CameraModel:
    """How a camera sees, and whether opacities make up for the blur.

    model: "pinhole"; "ortho", parallel rays; or "fisheye", an equidistant one, whose depth is the
    camera's z, too. blur: square pixels; near, far: depths within which Gaussians are drawn;
    smallest_radius: boxes that reach no more pixels along both axes are culled; reach: how many
    standard deviations from the centre boxes end, None if they end where alpha is below its cut.
    """

    model: str = "pinhole"
    compensated: bool = False
    blur: float = 0.3
    near: float = 0.01
    far: float = 1e10
    smallest_radius: float = 0.0
    reach: float | None = None


@dataclass(frozen=True)
class SplatGradients:
    """Gradients by the fields of :class:`Splats`, and of the camera's matrix.

    d_camera (3, 4, N): the share of every Gaussian in [R | t]; None if not wanted.
    """

    d_mean: DeviceArray
    d_shape: DeviceArray
    d_rotation: DeviceArray | None
    d_opacity: DeviceArray
    d_camera: DeviceArray | None


def pack_camera(
    viewmat: npt.NDArray[np.floating],
    intrinsics: npt.NDArray[np.floating],
    size: tuple[int, int],
    near: float,
) -> npt.NDArray[np.float32]:
    """A camera (26,) float32, the layout of ``Camera.pack``, of matrices (4, 4) and (3, 3)."""
    a, b, c = rows = np.asarray(viewmat, np.float64).tolist()[:3]
    (fx, _, cx), (_, fy, cy) = np.asarray(intrinsics, np.float64).tolist()[:2]
    # the matrix's inverse by its minors: plain numbers, for NumPy takes longer
    minors = _cross(b, c), _cross(c, a), _cross(a, b)
    determinant = sum(x * y for x, y in zip(a, minors[0], strict=False))
    centre = [
        -sum(m[k] * row[3] for m, row in zip(minors, rows, strict=True)) / determinant
        for k in range(3)
    ]
    limits = [
        (edge - middle) / focal
        for extent, middle, focal in ((size[0], cx, fx), (size[1], cy, fy))
        for edge in (-FRUSTUM_MARGIN * extent, (1 + FRUSTUM_MARGIN) * extent)
    ]
    rest = fx, fy, cx, cy, *size, near, *limits
    turn = [x for row in rows for x in row[:3]]
    return np.array([*turn, *(row[3] for row in rows), *rest, *centre], np.float32)


def _cross(u: list[float], v: list[float]) -> tuple[float, float, float]:
    """The cross product of the first three numbers of each."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def forward(
    device: Device,
    splats: Splats,
    camera: DeviceArray,
    lens: CameraModel,
    color: DeviceArray,
    options: RenderOptions,
) -> Projected:
    """Project N Gaussians; opacities are compensated if the lens says so, 0 if culled.

    A depth is NaN if a number of its Gaussian cannot be used: it is not finite, the quaternion is
    0, or the opacity is not between 0 and ``UNIT_OPACITY``.

    ``camera``: (26,) float32 from :func:`pack_camera`; ``color``: what ``Projected`` will hold.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(splats, camera)
    made = device.empty_together(
        mean2d=(count, 2), whitening=(count, 3), depth=(count,), extent=(count, 2), opacity=(count,)
    )
    result = Projected(**made, color=color)
    device.run(
        device.kernel(
            "views/views",
            "views_forward",
            **_defines(device, splats, lens),
            ALPHA_CUT=options.accuracy.alpha_cut,
        ),
        *by_lanes(device, count, device.lanes),
        mean=splats.mean,
        shape=splats.shape,
        rotation=splats.rotation or splats.shape,
        opacity=splats.opacity,
        camera=camera,
        count=np.int32(count),
        blur=np.float32(lens.blur),
        far=np.float32(lens.far),
        smallest_radius=np.float32(lens.smallest_radius),
        reach=np.float32(lens.reach or 0.0),
        mean2d=result.mean2d,
        whitening=result.whitening,
        depth=result.depth,
        extent=result.extent,
        compensated=result.opacity,
    )
    return result


def backward(
    device: Device,
    splats: Splats,
    camera: DeviceArray,
    lens: CameraModel,
    projected: Projected,
    d_projected: ChannelGradients,
    want_camera: bool = False,
) -> SplatGradients:
    """Gradients from those of the projections; zero for culled Gaussians.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    count = _check(splats, camera)
    shapes = Shapes(N=count)
    shapes.check("d_mean2d", d_projected.d_mean2d, "N 2", np.float32)
    shapes.check("d_whitening", d_projected.d_whitening, "N 3", np.float32)
    shapes.check("d_opacity", d_projected.d_opacity, "N", np.float32)
    rotation = splats.rotation
    made = device.empty_together(
        d_mean=(count, 3),
        d_shape=splats.shape.shape,
        d_rotation=None if rotation is None else (count, 4),
        d_opacity=(count,),
    )
    d_camera = device.empty((3, 4, count)) if want_camera else None
    result = SplatGradients(**made, d_camera=d_camera)
    unused = device.empty((1,))
    device.run(
        device.kernel("views/views", "views_backward", **_defines(device, splats, lens)),
        *by_lanes(device, count, device.lanes),
        mean=splats.mean,
        shape=splats.shape,
        rotation=unused if rotation is None else rotation,
        opacity=splats.opacity,
        camera=camera,
        count=np.int32(count),
        blur=np.float32(lens.blur),
        whitening=projected.whitening,
        extent=projected.extent,
        d_mean2d=d_projected.d_mean2d,
        d_whitening=d_projected.d_whitening,
        d_depth=d_projected.d_depth or device.zeros((count,)),
        d_compensated=d_projected.d_opacity,
        want_camera=np.int32(want_camera),
        **{name: unused if array is None else array for name, array in vars(result).items()},
    )
    return result


def _defines(device: Device, splats: Splats, lens: CameraModel) -> dict[str, int | float]:
    return {
        "VEC": device.lanes,
        "PARALLEL_RAYS": int(lens.model == "ortho"),
        "FISHEYE": int(lens.model == "fisheye"),
        "BY_COVARIANCE": int(splats.rotation is None),
        "COMPENSATED": int(lens.compensated),
    }


def _check(splats: Splats, camera: DeviceArray) -> int:
    """N; raises ValueError or TypeError if an array has the wrong shape or dtype."""
    shapes = Shapes()
    shapes.check("mean", splats.mean, "N 3", np.float32)
    if splats.rotation is None:
        shapes.check("shape", splats.shape, "N 6", np.float32)
    else:
        shapes.check("shape", splats.shape, "N 3", np.float32)
        shapes.check("rotation", splats.rotation, "N 4", np.float32)
    shapes.check("opacity", splats.opacity, "N", np.float32)
    shapes.check("camera", camera, "26", np.float32)
    return shapes.axes["N"]
