"""Projection for any camera in float64, by whole covariance matrices, with all its gradients.

By an equidistant fisheye of focal length 1, a point (x, y, z) appears at (x, y) g, with
g = arctan2(r, z) / r and r the distance from the axis. Near the axis, where quotients lose their
digits, power series in (r / z)^2 take their place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT, UNIT_OPACITY
from clgs.reference.project import (
    Array,
    Projected,
    UnpackedCamera,
    across,
    covariance_gradient,
    jacobian,
    quaternion_gradient,
    rotation_matrix,
    unpack,
)

NEAR_AXIS, TERMS = 0.02, 8


@dataclass(frozen=True)
class CameraModel:
    """The fields of the op's ``CameraModel`` that change numbers; near is the camera's."""

    model: str = "pinhole"
    compensated: bool = False
    blur: float = 0.3
    far: float = 1e10
    smallest_radius: float = 0.0
    reach: float | None = None


@dataclass(frozen=True)
class Gradients:
    """d_mean (N, 3), d_covariance (N, 3, 3) symmetric, d_opacity (N,), d_camera (3, 4)."""

    d_mean: Array
    d_covariance: Array
    d_opacity: Array
    d_camera: Array


@dataclass(frozen=True)
class _Seen:
    """point (N, 3), jacobian (N, 2, 3), free (N, 2), sharp (N, 2, 2): covariance without blur."""

    point: Array
    jacobian: Array
    free: npt.NDArray[np.bool_]
    sharp: Array


def covariances(scale: Array, rotation: Array) -> Array:
    """(N, 3, 3) of scales (N, 3) and quaternions (N, 4) of any length."""
    unit = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
    axes = rotation_matrix(unit) * scale[:, None, :]
    return np.asarray(axes @ axes.transpose(0, 2, 1))


def shape_gradients(scale: Array, rotation: Array, d_covariance: Array) -> tuple[Array, Array]:
    """d_scale and d_rotation from symmetric gradients by covariances."""
    norm = np.linalg.norm(rotation, axis=1, keepdims=True)
    unit = rotation / norm
    matrix = rotation_matrix(unit)
    d_axes = 2 * d_covariance @ (matrix * scale[:, None, :])
    d_unit = quaternion_gradient(unit, d_axes * scale[:, None, :])
    return np.sum(d_axes * matrix, axis=1), across(unit, d_unit) / norm


def forward(
    mean: Array,
    covariance: Array,
    opacity: Array,
    camera: npt.NDArray[np.floating],
    lens: CameraModel,
) -> tuple[Projected, Array]:
    """Projections and opacities; shapes as in ``clgs.ops.general.views``, covariances (N, 3, 3)."""
    view = unpack(camera)
    with np.errstate(all="ignore"):
        seen = _see(view, mean, covariance, lens)
        cov = seen.sharp + lens.blur * np.eye(2)
        xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
        whitening = np.stack([xx**-0.5, xy / xx, np.sqrt(xx / (xx * yy - xy * xy))], 1)
        given, opacity = opacity, opacity * _share(seen, lens)
        by_alpha, shows = np.sqrt(2 * np.log(opacity / ALPHA_CUT)), opacity >= ALPHA_CUT
        if lens.reach is not None:
            by_alpha, shows = np.full(len(mean), lens.reach), opacity >= 0
        extent = by_alpha[:, None] * np.sqrt(np.stack([xx, yy], 1))
        if lens.model == "fisheye":
            slope = seen.point[:, :2] * _bend(seen.point).factor[:, None]
        else:
            slope = seen.point[:, :2] / (1 if lens.model == "ortho" else seen.point[:, 2:])
        mean2d = view.focal * slope + view.centre2d
        radii = np.ceil(extent)
        drawn = np.all((mean2d + radii > 0) & (mean2d - radii < view.size), axis=1)
        drawn &= np.max(radii, axis=1) > lens.smallest_radius
    depth = seen.point[:, 2]
    drawn &= (depth >= view.near) & (depth <= lens.far) & shows
    drawn &= np.all(np.isfinite(whitening), axis=1)
    numbers = np.concatenate([mean, covariance.reshape(-1, 9)], axis=1)
    usable = np.all(np.isfinite(numbers), axis=1) & (given >= 0) & (given <= UNIT_OPACITY)
    keep = drawn[:, None]
    projected = Projected(
        np.where(keep, mean2d, 0),
        np.where(keep, whitening, 0),
        np.where(usable, np.where(drawn, depth, 0), np.nan),
        np.where(keep, extent, 0),
    )
    return projected, np.where(drawn, opacity, 0)


def backward(
    mean: Array,
    covariance: Array,
    opacity: Array,
    camera: npt.NDArray[np.floating],
    lens: CameraModel,
    d_mean2d: Array,
    d_whitening: Array,
    d_depth: Array,
    d_compensated: Array,
) -> Gradients:
    """Gradients from those of the projections; of drawn Gaussians alone."""
    drawn = forward(mean, covariance, opacity, camera, lens)[0].extent[:, 0] > 0
    view = unpack(camera)
    seen = _see(view, mean[drawn], covariance[drawn], lens)
    cov = seen.sharp + lens.blur * np.eye(2)
    share = _share(seen, lens)
    d_cov = covariance_gradient(cov, d_whitening[drawn])
    d_log_share = d_compensated[drawn] * opacity[drawn] * share
    if lens.compensated:
        d_cov += 0.5 * d_log_share[:, None, None] * (np.linalg.inv(seen.sharp) - np.linalg.inv(cov))
    j, w = seen.jacobian, view.rotation
    in_camera = w @ covariance[drawn] @ w.T
    d_j = 2 * d_cov @ j @ in_camera
    d_point = _point_gradient(view, seen, lens, d_mean2d[drawn], d_j)
    d_point[:, 2] += d_depth[drawn]
    d_in_camera = j.transpose(0, 2, 1) @ d_cov @ j
    d_rotation = np.sum(2 * d_in_camera @ w @ covariance[drawn], axis=0)
    d_rotation += d_point.T @ mean[drawn]
    result = Gradients(
        np.zeros_like(mean),
        np.zeros_like(covariance),
        np.zeros_like(opacity),
        np.concatenate([d_rotation, d_point.sum(axis=0)[:, None]], axis=1),
    )
    result.d_mean[drawn] = d_point @ w
    result.d_covariance[drawn] = w.T @ d_in_camera @ w
    result.d_opacity[drawn] = d_compensated[drawn] * share
    return result


def _see(view: UnpackedCamera, mean: Array, covariance: Array, lens: CameraModel) -> _Seen:
    point = mean @ view.rotation.T + view.translation
    matrix, free = np.zeros((len(point), 2, 3)), np.ones((len(point), 2), bool)
    if lens.model == "fisheye":
        b, aside = _bend(point), point[:, :2]
        matrix[:, :, :2] = b.factor[:, None, None] * np.eye(2)
        matrix[:, :, :2] += b.first[:, None, None] * aside[:, :, None] * aside[:, None, :]
        matrix[:, :, 2] = -aside / np.sum(point**2, axis=1)[:, None]
        matrix *= view.focal[:, None]
    elif lens.model == "ortho":
        matrix[:, [0, 1], [0, 1]] = view.focal
    else:
        matrix, free = jacobian(view, point)
    transform = matrix @ view.rotation
    return _Seen(point, matrix, free, transform @ covariance @ transform.transpose(0, 2, 1))


def _share(seen: _Seen, lens: CameraModel) -> Array:
    """Share of the opacity that is left, (N,)."""
    if not lens.compensated:
        return np.ones(len(seen.point))
    blurred = np.linalg.det(seen.sharp + lens.blur * np.eye(2))
    return np.asarray(np.sqrt(np.maximum(np.linalg.det(seen.sharp), 0) / blurred))


def _point_gradient(
    view: UnpackedCamera, seen: _Seen, lens: CameraModel, d_mean2d: Array, d_j: Array
) -> Array:
    d_point = np.zeros_like(seen.point)
    if lens.model == "fisheye":
        d_point += np.einsum("ni,nij->nj", d_mean2d, seen.jacobian)
        by_point = view.focal[:, None, None] * _fisheye_curvature(seen.point)
        return np.asarray(d_point + np.einsum("nij,nijk->nk", d_j, by_point))
    if lens.model == "ortho":
        d_point[:, :2] = d_mean2d * view.focal
        return d_point
    z = seen.point[:, 2:]
    slope = seen.point[:, :2] / z
    # the Jacobian's entries are 1/z times what depends on the slopes
    d_slope = view.focal * (d_mean2d - np.where(seen.free, d_j[:, :, 2] / z, 0))
    d_point[:, :2] = d_slope / z
    by_depth = np.sum(d_j * seen.jacobian, axis=(1, 2)) + np.sum(d_slope * slope, axis=1)
    d_point[:, 2] = -by_depth / z[:, 0]
    return d_point


@dataclass(frozen=True)
class _Bend:
    """g, (dg/dr) / r and the same of that, (N,) each."""

    factor: Array
    first: Array
    second: Array


def _bend(point: Array) -> _Bend:
    """The numbers of points (N, 3) in camera space."""
    z, r = point[:, 2], np.hypot(point[:, 0], point[:, 1])
    square = r**2 + z**2
    with np.errstate(all="ignore"):
        g = np.arctan2(r, z) / r
        first = (z / square - g) / r**2
        second = -(2 * z / square**2 + 3 * first) / r**2
        s, k = (r / z)[:, None] ** 2, np.arange(TERMS)
        of_g = (-1) ** k / (2 * k + 1)
        of_first = 2 * (k[:-1] + 1) * of_g[1:]
        of_second = 2 * (k[:-2] + 1) * of_first[1:]
        series = [
            np.sum(terms * s ** k[: len(terms)], axis=1) / z**power
            for terms, power in ((of_g, 1), (of_first, 3), (of_second, 5))
        ]
        near = r < NEAR_AXIS * z
    pairs = zip(series, (g, first, second), strict=True)
    return _Bend(*(np.where(near, one, other) for one, other in pairs))


def _fisheye_curvature(point: Array) -> Array:
    """Derivatives (N, 2, 3, 3) of the Jacobian by the point, which is the last axis."""
    b, p, one = _bend(point), point[:, :2], np.eye(2)
    square, z = np.sum(point**2, axis=1)[:, None, None], point[:, 2]
    result = np.zeros((len(point), 2, 3, 3))
    symmetric = (
        np.einsum("ij,nk->nijk", one, p)
        + np.einsum("ik,nj->nijk", one, p)
        + np.einsum("jk,ni->nijk", one, p)
    )
    cubic = np.einsum("ni,nj,nk->nijk", p, p, p)
    result[:, :, :2, :2] = np.einsum("n,nijk->nijk", b.first, symmetric)
    result[:, :, :2, :2] += np.einsum("n,nijk->nijk", b.second, cubic)
    by_depth = 2 * p[:, :, None] * p[:, None, :] / square**2 - one / square
    result[:, :, :2, 2] = by_depth
    result[:, :, 2, :2] = by_depth
    result[:, :, 2, 2] = 2 * p * z[:, None] / square[:, 0] ** 2
    return result
