"""Ordinary Gaussians from what cameras see of neural ones, and then refined by gradient descent.

Two passes over the views. The first sums what each slot contributes, and the means of its opacity
and covariance, weighted by that; slots that contribute next to nothing to every view are left out.
The second sums the normal equations of the color: for basis b, color c and weight w
    (sum w b b^T + ridge) sh = sum w b (c - 0.5).
Most Gaussians are seen from one side only, so all coefficients but the constant have a ridge,
relative to the weight. The refined ones look like pictures of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS
from clgs.data.masks import Mask
from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, loss, mask
from clgs.options import DEFAULT
from clgs.reference.general.splats import HARMONICS
from clgs.reference.project import rotation_matrix
from clgs.render.frame import EXACT_ROOM, DeviceScene, DeviceView
from clgs.render.rasterise import blend_backward, rasterise, rasterise_backward, with_enough_room
from clgs.scene.gaussians import HostGaussians, OrdinaryGaussians
from clgs.train.quality.importance import LEAST_WEIGHT

RIDGE = 0.02
"""Ridge of a coefficient, in units of the mean of w b^2."""

MAX_OPACITY = 0.99
MIN_SCALE = 1e-9
SOLVED_AT_ONCE = 4096

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Observation:
    """M neural Gaussians that contribute to one picture.

    slot (M,) int64: anchor times K plus number of the offset, each at most once; weight (M,):
    sum over the pixels of alpha times transmittance, in pixels; direction (M, 3): unit, from the
    camera; mean (M, 3), scale (M, 3), rotation (M, 4), color (M, 3), opacity (M,) as in
    ``clgs.ops.neural.Gaussians``. Float32.
    """

    slot: npt.NDArray[np.int64]
    weight: Array
    direction: Array
    mean: Array
    scale: Array
    rotation: Array
    color: Array
    opacity: Array


def observe(
    device: Device, scene: DeviceScene, views: Iterable[tuple[DeviceView, Mask | None]]
) -> Iterator[Observation]:
    """What each of ``views`` shows of ``scene`` in the pixels that its mask leaves.

    The picture is linear in the colors: its derivative by a Gaussian's color is what that Gaussian
    contributes.
    """
    room = EXACT_ROOM
    for view, used in views:
        frame, room = with_enough_room(rasterise, device, scene, view, DEFAULT, room)
        counted = np.ones(frame.image.shape, np.float32)
        counted *= 1 if used is None else used
        gradients = blend_backward(device, frame, device.upload(counted))
        weight = device.download(gradients.d_color)[:, 0]
        seen = np.flatnonzero(weight > 0)
        mean, scale, rotation, color, opacity = (
            device.download(getattr(frame.gaussians, name))[seen]
            for name in ("mean", "scale", "rotation", "color", "opacity")
        )
        offset = mean - device.download(view.camera)[-3:]
        direction = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        slot = device.download(frame.gaussians.slot)[seen]
        anchor = device.download(frame.activations.visible).astype(np.int64)[slot // K_OFFSETS]
        slot = anchor * K_OFFSETS + slot % K_OFFSETS
        del frame  # before the next one is made
        yield Observation(slot, weight[seen], direction, mean, scale, rotation, color, opacity)


def fit(
    observations: Callable[[], Iterable[Observation]], slots: int, degree: int
) -> HostGaussians:
    """Gaussians in scene units for those of ``slots`` slots, anchors times K, that matter.

    ``observations`` gives the observations of all views, each time it is called; ``degree``: of the
    spherical harmonics, 0 to 3.
    """
    most, weights = np.zeros(slots, np.float32), np.zeros(slots)
    reach, covariance = np.zeros(slots), np.zeros((slots, 6))
    mean = np.zeros((slots, 3), np.float32)
    for seen in observations():
        at, weight = seen.slot, seen.weight.astype(np.float64)
        most[at] = np.maximum(most[at], seen.weight)
        weights[at] += weight
        reach[at] += weight / seen.opacity
        mean[at] = seen.mean
        axes = rotation_matrix(seen.rotation.astype(np.float64)) * seen.scale[:, None, :]
        whole = axes @ axes.transpose(0, 2, 1)
        covariance[at] += weight[:, None] * whole[:, *np.triu_indices(3)]
    kept = np.flatnonzero(most >= LEAST_WEIGHT)
    square, axes = np.linalg.eigh(_symmetric(covariance[kept] / weights[kept, None], 3))
    axes *= np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]
    log_scale = 0.5 * np.log(np.maximum(square, MIN_SCALE**2))
    opacity = np.clip(weights[kept] / reach[kept], 1e-3, MAX_OPACITY)
    return OrdinaryGaussians(
        mean=mean[kept],
        log_scale=log_scale.astype(np.float32),
        rotation=quaternions(axes).astype(np.float32),
        opacity=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=_fit_colors(observations(), kept, slots, degree),
    )


def _fit_colors(
    observations: Iterable[Observation], kept: npt.NDArray[np.int64], slots: int, degree: int
) -> Array:
    """Coefficients (len(kept), C, 3) of the slots that are kept: solutions of ridge regressions."""
    number = np.full(slots, -1)
    number[kept] = np.arange(len(kept))
    size = (degree + 1) ** 2
    rows, columns = np.triu_indices(size)
    normal = np.zeros((len(kept), len(rows)), np.float32)
    right = np.zeros((len(kept), size, 3), np.float32)
    for seen in observations:
        fitted = number[seen.slot] >= 0
        at = number[seen.slot[fitted]]
        basis = harmonics(seen.direction[fitted], degree)
        weighted = basis * seen.weight[fitted, None]
        normal[at] += weighted[:, rows] * basis[:, columns]
        right[at] += weighted[:, :, None] * (seen.color[fitted, None] - np.float32(0.5))
    result = np.empty_like(right)
    penalty = np.diag(np.where(np.arange(size) == 0, 1e-6, RIDGE))
    for start in range(0, len(right), SOLVED_AT_ONCE):
        some = slice(start, start + SOLVED_AT_ONCE)
        whole = _symmetric(normal[some], size)
        # b_0 is constant, so that w b_0^2 summed up is the total weight over 4 pi
        whole += whole[:, :1, :1] * penalty
        result[some] = np.linalg.solve(whole, right[some].astype(np.float64))
    return result


def _symmetric(triangle: npt.NDArray[np.floating], size: int) -> npt.NDArray[np.float64]:
    """Symmetric matrices (N, size, size) with the upper triangles (N, size (size + 1) / 2)."""
    rows, columns = np.triu_indices(size)
    whole = np.empty((len(triangle), size, size))
    whole[:, rows, columns] = whole[:, columns, rows] = triangle
    return whole


def quaternions(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Unit quaternions (N, 4), w x y z, w >= 0, of rotation matrices (N, 3, 3).

    The quaternion is the row of the symmetric 4x4 matrix 4 q q^T whose diagonal entry is largest,
    divided by its length.
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


RATES = {"mean": 3e-5, "log_scale": 4e-3, "rotation": 2e-3, "opacity": 2e-2, "sh": 2e-3}
"""Learning rates of the first step; that of the mean in units of the cameras' radius."""

LAST_RATE = 0.1
"""Rates fall exponentially, to this share of the first ones."""


Target = tuple[DeviceView, DeviceArray, DeviceArray | None]
"""A view, and what it is to show on the device: the picture (3, H, W) uint8, zero where it is
masked; and what is used of it (H, W) uint8, of 0 and 1, None if nothing is masked."""


def refine(
    device: Device,
    gaussians: HostGaussians,
    targets: Iterable[Target],
    steps: int,
    radius: float,
    on_step: Callable[[], None] = lambda: None,
) -> HostGaussians:
    """One step of Adam for each of the first ``steps`` targets, with the loss of training.

    ``targets``: at least ``steps``; ``radius``: of the cameras, scene units; ``on_step`` is called
    after each step.

    Raises:
        ClgsError: a gradient is not finite.
    """
    stored, room = gaussians.map(device.upload), EXACT_ROOM
    moments = {name: adam.zero_moments(device, array) for name, array in stored.items()}
    stop = adam.stop_flag(device)
    for number, (view, picture, used) in zip(range(1, steps + 1), targets, strict=False):
        frame, room = with_enough_room(rasterise, device, stored, view, DEFAULT, room)
        image = frame.image if used is None else mask.forward(device, frame.image, used)
        compared = loss.forward(device, image, picture)
        d_image = loss.backward(device, image, picture, compared)
        d_image = d_image if used is None else mask.backward(device, d_image, used)
        gradients = dict(rasterise_backward(device, stored, frame, d_image).d_stored.items())
        del frame  # before the next one is made
        adam.check_finite(device, gradients.values(), stop)
        fall = LAST_RATE ** ((number - 1) / max(steps - 1, 1))
        updates = []
        for name, array in stored.items():
            rate = RATES[name] * (radius if name == "mean" else 1.0) * fall
            trained = adam.Trained(array, gradients[name], moments[name])
            updates.append(adam.Update(trained, adam.factors(rate, number)))
        adam.step(device, updates, stop)
        on_step()
    if device.download(stop)[0]:
        raise ClgsError("baking: a gradient is not finite; give --steps 0 to export unrefined")
    return stored.map(device.download)
