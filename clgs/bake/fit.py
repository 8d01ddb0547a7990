"""Ordinary Gaussians from what cameras see of neural ones.

Two passes over the views. The first sums, for each slot, what it contributes, and the means of
opacity and covariance, weighted by that; slots that contribute next to nothing to every view go.
The second sums the normal equations of the color: for basis b, color c and weight w
    (sum w b b^T + ridge) sh = sum w b (c - 0.5),
with a ridge on all but the constant, relative to the weight, since most Gaussians are seen from
one side only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.bake.observe import Observation
from clgs.reference.project import rotation_matrix
from clgs.reference.splats import HARMONICS
from clgs.scene.gaussians import HostGaussians, OrdinaryGaussians

RIDGE = 0.02
"""Of the coefficients, in units of the mean of w b^2."""

LEAST_WEIGHT = 0.3
"""Pixels: Gaussians that contribute less to every view are left out."""

MAX_OPACITY = 0.99
MIN_SCALE = 1e-9
SOLVED_AT_ONCE = 4096

Views = Callable[[], Iterable[Observation]]


@dataclass(frozen=True)
class _Sums:
    """Sums over all views for every slot: the most and the total weight, and moments."""

    most: npt.NDArray[np.float32]
    weight: npt.NDArray[np.float64]
    reach: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float32]
    covariance: npt.NDArray[np.float64]


def fit(views: Views, slots: int, degree: int) -> HostGaussians:
    """Gaussians in scene units for those of ``slots`` slots that matter.

    Args:
        views: gives the observations of all views, each time it is called.
        slots: anchors times K.
        degree: of the spherical harmonics, 0 to 3.
    """
    sums = _sum_shapes(views(), slots)
    kept = np.flatnonzero(sums.most >= LEAST_WEIGHT)
    number = np.full(slots, -1)
    number[kept] = np.arange(len(kept))
    log_scale, rotation = _axes(sums.covariance[kept] / sums.weight[kept, None])
    opacity = np.clip(sums.weight[kept] / sums.reach[kept], 1e-3, MAX_OPACITY)
    return OrdinaryGaussians(
        mean=sums.mean[kept],
        log_scale=log_scale,
        rotation=rotation,
        opacity=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=_fit_colors(views(), number, len(kept), degree),
    )


def _sum_shapes(views: Iterable[Observation], slots: int) -> _Sums:
    sums = _Sums(
        most=np.zeros(slots, np.float32),
        weight=np.zeros(slots),
        reach=np.zeros(slots),
        mean=np.zeros((slots, 3), np.float32),
        covariance=np.zeros((slots, 6)),
    )
    for seen in views:
        at, weight = seen.slot, seen.weight.astype(np.float64)
        sums.most[at] = np.maximum(sums.most[at], seen.weight)
        sums.weight[at] += weight
        sums.reach[at] += weight / seen.opacity
        sums.mean[at] = seen.mean
        axes = rotation_matrix(seen.rotation.astype(np.float64)) * seen.scale[:, None, :]
        whole = axes @ axes.transpose(0, 2, 1)
        sums.covariance[at] += weight[:, None] * whole[:, *np.triu_indices(3)]
    return sums


def _axes(
    covariance: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Log scales (N, 3) and rotations (N, 4) of upper triangles (N, 6)."""
    rows, columns = np.triu_indices(3)
    whole = np.empty((len(covariance), 3, 3))
    whole[:, rows, columns] = whole[:, columns, rows] = covariance
    square, axes = np.linalg.eigh(whole)
    axes *= np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]
    log_scale = 0.5 * np.log(np.maximum(square, MIN_SCALE**2))
    return log_scale.astype(np.float32), quaternions(axes).astype(np.float32)


def quaternions(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Unit quaternions (N, 4), w x y z, w >= 0, of rotation matrices (N, 3, 3).

    The row of the symmetric 4x4 matrix 4 q q^T whose diagonal entry is largest, made a unit.
    """
    m = matrix
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    outer = np.array(
        [
            [1 + xx + yy + zz, wx, wy, wz],
            [wx, 1 + xx - yy - zz, xy, xz],
            [wy, xy, 1 - xx + yy - zz, yz],
            [wz, xz, yz, 1 - xx - yy + zz],
        ]
    ).transpose(2, 0, 1)
    largest = np.argmax(np.einsum("nii->ni", outer), axis=1)
    q = outer[np.arange(len(m)), largest]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.asarray(np.where(q[:, :1] < 0, -q, q))


def _fit_colors(
    views: Iterable[Observation], number: npt.NDArray[np.int64], count: int, degree: int
) -> npt.NDArray[np.float32]:
    """Coefficients (count, C, 3) of the kept slots; ``number`` (slots,) is -1 for the others."""
    rows, columns = np.triu_indices((degree + 1) ** 2)
    normal = np.zeros((count, len(rows)), np.float32)
    right = np.zeros((count, (degree + 1) ** 2, 3), np.float32)
    for seen in views:
        kept = number[seen.slot] >= 0
        at = number[seen.slot[kept]]
        basis = harmonics(seen.direction[kept], degree)
        weighted = basis * seen.weight[kept, None]
        normal[at] += weighted[:, rows] * basis[:, columns]
        right[at] += weighted[:, :, None] * (seen.color[kept, None] - np.float32(0.5))
    return _solve(normal, right)


def harmonics(direction: npt.NDArray[np.float32], degree: int) -> npt.NDArray[np.float32]:
    """The basis (N, C) at unit directions (N, 3)."""
    one = np.ones(len(direction), np.float32)
    powers = [(one, x, x * x, x * x * x) for x in direction.T]
    columns = [
        sum(
            np.float32(factor) * powers[0][i] * powers[1][j] * powers[2][k]
            for (i, j, k), factor in polynomial.items()
        )
        for polynomial in HARMONICS[: (degree + 1) ** 2]
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def _solve(
    normal: npt.NDArray[np.float32], right: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """The solutions of ridge regressions with normal matrices given by upper triangles."""
    size = right.shape[1]
    rows, columns = np.triu_indices(size)
    result = np.empty_like(right)
    penalty = np.diag(np.where(np.arange(size) == 0, 1e-6, RIDGE))
    for start in range(0, len(right), SOLVED_AT_ONCE):
        part = slice(start, start + SOLVED_AT_ONCE)
        whole = np.empty((len(right[part]), size, size))
        whole[:, rows, columns] = whole[:, columns, rows] = normal[part]
        # b_0 is constant, so that w b_0^2 summed up is the total weight over 4 pi
        whole += whole[:, :1, :1] * penalty
        result[part] = np.linalg.solve(whole, right[part].astype(np.float64))
    return result
