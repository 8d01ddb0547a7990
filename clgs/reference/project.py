"""Projection in float64, written from the equations of EWA splatting.

Forward and backward work on whole covariance matrices and their inverse, unlike the kernel, which
carries a factor: in float64 both agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT, BLUR, PIXEL_VARIANCE

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Projected:
    """The fields of ``clgs.ops.project.Projected``, float64: mean2d, whitening, depth, extent."""

    mean2d: Array
    whitening: Array
    depth: Array
    extent: Array


@dataclass(frozen=True)
class UnpackedCamera:
    """The packed camera (26,) by name."""

    rotation: Array
    translation: Array
    focal: Array
    centre2d: Array
    size: Array
    near: float
    limits: Array


def unpack(camera: npt.NDArray[np.floating]) -> UnpackedCamera:
    """Name the entries of ``Camera.pack``."""
    c = np.asarray(camera, np.float64)
    return UnpackedCamera(
        rotation=c[0:9].reshape(3, 3),
        translation=c[9:12],
        focal=c[12:14],
        centre2d=c[14:16],
        size=c[16:18],
        near=float(c[18]),
        limits=c[19:23].reshape(2, 2),
    )


def rotation_matrix(rotation: Array) -> Array:
    """(N, 3, 3) of unit quaternions (N, 4), w x y z."""
    w, x, y, z = rotation.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def jacobian(view: UnpackedCamera, point: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """J (N, 2, 3) at camera-space points (N, 3), and which of x/z, y/z (N, 2) lie in the limits."""
    slope = point[:, :2] / point[:, 2:]
    clamped = np.clip(slope, view.limits[:, 0], view.limits[:, 1])
    matrix = np.zeros((len(point), 2, 3))
    for axis in range(2):
        matrix[:, axis, axis] = view.focal[axis] / point[:, 2]
        matrix[:, axis, 2] = -view.focal[axis] * clamped[:, axis] / point[:, 2]
    return matrix, clamped == slope


def blurs(view: UnpackedCamera, mean: Array, screen: Sequence[float]) -> tuple[Array, Array]:
    """Blur on the screen, and the blur that was learned, (N,) each, square pixels.

    ``screen``: the numbers of ``clgs.ops.project.Screen``.
    """
    *point, nearest, farthest, enlarged, learned, blur = screen
    if enlarged == 0:
        return np.full(len(mean), float(blur)), np.full(len(mean), float(learned))
    inside = np.linalg.norm(mean - np.array(point), axis=1)
    away = np.linalg.norm(mean + view.rotation.T @ view.translation, axis=1)
    least = np.maximum(nearest - inside, inside - farthest)
    size = enlarged * np.clip(away, least, farthest + inside) / away
    pixel = np.maximum(1 - size**2, 0) * PIXEL_VARIANCE
    return blur * size**2 + pixel, learned * size**2


def shown_opacity(
    gaussians: tuple[Array, Array, Array],
    opacity: Array,
    camera: npt.NDArray[np.floating],
    screen: Sequence[float],
) -> Array:
    """Opacities (N,) on the screen, of Gaussians by mean, scale and rotation."""
    view, mean = unpack(camera), gaussians[0]
    blur, learned = blurs(view, mean, screen)
    sharp = np.linalg.det(covariance2d(view, *gaussians, learned))
    share = np.sqrt(np.maximum(sharp, 0) / np.linalg.det(covariance2d(view, *gaussians, blur)))
    return np.asarray(opacity * share)


def covariance2d(
    view: UnpackedCamera, mean: Array, scale: Array, rotation: Array, blur: Array | float = BLUR
) -> Array:
    """Screen-space covariance (N, 2, 2) blurred by ``blur``, one or (N,), square pixels."""
    point = mean @ view.rotation.T + view.translation
    axes = rotation_matrix(rotation) * scale[:, None, :]
    covariance = axes @ axes.transpose(0, 2, 1)
    transform = jacobian(view, point)[0] @ view.rotation
    sharp = transform @ covariance @ transform.transpose(0, 2, 1)
    return np.asarray(sharp + np.multiply.outer(blur, np.eye(2)))


def forward(
    mean: Array,
    scale: Array,
    rotation: Array,
    opacity: Array,
    camera: npt.NDArray[np.floating],
    min_extent: float = 0.0,
    alpha_cut: float = ALPHA_CUT,
    screen: Sequence[float] | None = None,
) -> Projected:
    """Project N Gaussians; shapes as in ``clgs.ops.project.forward``, ``min_extent`` in pixels."""
    view = unpack(camera)
    blur: Array | float = BLUR
    if screen is not None:
        blur = blurs(view, mean, screen)[0]
        opacity = shown_opacity((mean, scale, rotation), opacity, camera, screen)
    point = mean @ view.rotation.T + view.translation
    with np.errstate(all="ignore"):
        mean2d = view.focal * point[:, :2] / point[:, 2:] + view.centre2d
        cov = covariance2d(view, mean, scale, rotation, blur)
        xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
        whitening = np.stack([xx**-0.5, xy / xx, np.sqrt(xx / (xx * yy - xy * xy))], 1)
        reach = np.sqrt(2 * np.log(opacity / alpha_cut))
        extent = reach[:, None] * np.sqrt(np.stack([xx, yy], 1))
        inside = np.all((mean2d + extent > 0) & (mean2d - extent < view.size), axis=1)
        inside &= np.max(extent, axis=1) >= min_extent
    norm = np.sum(rotation**2, axis=1)
    drawn = inside & (point[:, 2] > view.near) & (opacity >= alpha_cut)
    drawn &= (norm > 0.99) & (norm < 1.01) & np.all(np.isfinite(whitening), axis=1)
    keep = drawn[:, None]
    return Projected(
        np.where(keep, mean2d, 0),
        np.where(keep, whitening, 0),
        np.where(drawn, point[:, 2], 0),
        np.where(keep, extent, 0),
    )


def backward(
    gaussians: tuple[Array, Array, Array],
    camera: npt.NDArray[np.floating],
    projected: Projected,
    d_mean2d: Array,
    d_whitening: Array,
    d_share: Array | None = None,
) -> tuple[Array, Array, Array]:
    """d_mean (N, 3), d_scale (N, 3), d_rotation (N, 4); shapes as in ``clgs.ops.project``.

    d_share (N,): of antialiased Gaussians, the gradient by the logarithm of the share of opacity
    that they keep, which is the gradient by ``shown_opacity`` times that.
    """
    mean, scale, rotation = gaussians
    drawn = projected.extent[:, 0] > 0
    result = np.zeros_like(mean), np.zeros_like(scale), np.zeros_like(rotation)
    parts = _backward_drawn(
        (mean[drawn], scale[drawn], rotation[drawn]),
        unpack(camera),
        d_mean2d[drawn],
        d_whitening[drawn],
        np.zeros(int(drawn.sum())) if d_share is None else d_share[drawn],
    )
    for whole, part in zip(result, parts, strict=True):
        whole[drawn] = part
    return result


def _backward_drawn(
    gaussians: tuple[Array, Array, Array],
    view: UnpackedCamera,
    d_mean2d: Array,
    d_whitening: Array,
    d_share: Array,
) -> tuple[Array, Array, Array]:
    mean, scale, rotation = gaussians
    point = mean @ view.rotation.T + view.translation
    blurred = covariance2d(view, mean, scale, rotation)
    d_cov2d = covariance_gradient(blurred, d_whitening)
    if d_share.any():
        sharp = covariance2d(view, mean, scale, rotation, 0.0)
        by_share = 0.5 * (np.linalg.inv(sharp) - np.linalg.inv(blurred))
        d_cov2d = d_cov2d + d_share[:, None, None] * by_share
    axes = rotation_matrix(rotation) * scale[:, None, :]
    cov_camera = view.rotation @ (axes @ axes.transpose(0, 2, 1)) @ view.rotation.T
    j, free = jacobian(view, point)
    d_j = 2 * d_cov2d @ j @ cov_camera
    d_point = _point_gradient(view, point, d_mean2d, d_j, free)
    transform = j @ view.rotation
    d_cov3d = transform.transpose(0, 2, 1) @ d_cov2d @ transform
    d_axes = 2 * d_cov3d @ axes
    d_scale = np.sum(d_axes * rotation_matrix(rotation), axis=1)
    d_rotation = quaternion_gradient(rotation, d_axes * scale[:, None, :])
    return d_point @ view.rotation, d_scale, d_rotation


def covariance_gradient(cov: Array, d_whitening: Array) -> Array:
    """Symmetric dL/dC (N, 2, 2) from dL/d(r1, l, r2) by the chain rule on their definitions."""
    xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    det = xx * yy - xy * xy
    d_r1, d_l, d_r2 = d_whitening.T
    r2 = np.sqrt(xx / det)
    d_xx = -0.5 * xx**-1.5 * d_r1 - xy / xx**2 * d_l + 0.5 * r2 * (1 / xx - yy / det) * d_r2
    d_xy = d_l / xx + r2 * xy / det * d_r2
    d_yy = -0.5 * r2 * xx / det * d_r2
    return np.stack([d_xx, 0.5 * d_xy, 0.5 * d_xy, d_yy], 1).reshape(-1, 2, 2)


def _point_gradient(
    view: UnpackedCamera, point: Array, d_mean2d: Array, d_j: Array, free: npt.NDArray[np.bool_]
) -> Array:
    z = point[:, 2]
    d_point = np.zeros_like(point)
    for axis in range(2):
        focal, limits = view.focal[axis], view.limits[axis]
        slope = point[:, axis] / z
        clamped = np.clip(slope, *limits)
        d_slope = focal * d_mean2d[:, axis] - np.where(
            free[:, axis], focal / z * d_j[:, axis, 2], 0
        )
        d_point[:, axis] += d_slope / z
        d_point[:, 2] -= d_slope * slope / z
        d_point[:, 2] += focal / z**2 * (clamped * d_j[:, axis, 2] - d_j[:, axis, axis])
    return d_point


def across(unit: Array, vector: Array) -> Array:
    """The part of each vector (N, n) at a right angle to the unit vector (N, n)."""
    return np.asarray(vector - np.sum(unit * vector, axis=1, keepdims=True) * unit)


def quaternion_gradient(rotation: Array, d_matrix: Array) -> Array:
    """dL/dq (N, 4): the derivative of every matrix entry by every component, contracted."""
    w, x, y, z = rotation.T
    zero = np.zeros_like(w)
    by_w = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    by_x = [[zero, y, z], [y, -2 * x, -w], [z, w, -2 * x]]
    by_y = [[-2 * y, x, w], [x, zero, z], [-w, z, -2 * y]]
    by_z = [[-2 * z, -w, x], [w, -2 * z, y], [x, y, zero]]
    derivative = 2 * np.array([by_w, by_x, by_y, by_z])
    return np.asarray(np.einsum("qijn,nij->nq", derivative, d_matrix))
