"""How far two reconstructions of the same photos differ, photo by photo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SAME = 1.0
"""Two photos give the same turn between two worlds if their turns differ by at most this, degrees.
"""

ROUNDS, OFF = 10, 4.0
"""Fits of the common scale, each without photos that are OFF times the median distance away."""


@dataclass(frozen=True)
class Poses:
    """Poses of N photos.

    names; rotation: (N, 3, 3), world to camera; centre: (N, 3), world units; depth: (N,), median
    distance of the points that a photo sees, world units.
    """

    names: list[str]
    rotation: Floats
    centre: Floats
    depth: Floats

    def chosen(self, names: list[str]) -> Poses:
        """Select the photos of these names, in this order."""
        place = {name: i for i, name in enumerate(self.names)}
        index = [place[name] for name in names]
        return Poses(names, self.rotation[index], self.centre[index], self.depth[index])


@dataclass(frozen=True)
class PoseDifference:
    """How far a photo's poses in two reconstructions differ, degrees.

    turn: angle between the rotations; shift: between the places, seen from the photo's points.
    """

    turn: float
    shift: float


def poses_of(model: Any) -> Poses:
    """Read the poses of a pycolmap reconstruction, in the order of names."""
    images = sorted((model.image(n) for n in model.reg_image_ids()), key=lambda image: image.name)
    rotation = [image.cam_from_world().rotation.matrix() for image in images]
    centre = [image.projection_center() for image in images]
    points = model.points3D
    numbers = np.array(sorted(points), np.uint64)
    places = np.reshape([points[number].xyz for number in numbers.tolist()], (-1, 3))
    depth = []
    for image in images:
        seen = [point.point3D_id for point in image.get_observation_points2D()]
        found = places[np.searchsorted(numbers, np.array(seen, np.uint64))]
        away = np.linalg.norm(found - image.projection_center(), axis=1)
        depth.append(float(np.median(away)) if seen else 1.0)
    arrays = np.reshape(rotation, (-1, 3, 3)), np.reshape(centre, (-1, 3)), np.array(depth)
    return Poses([image.name for image in images], *arrays)


@dataclass(frozen=True)
class Similarity:
    """A map between worlds: x_second = scale turn x_first + offset; turn (3, 3), offset (3,)."""

    turn: Floats
    scale: float
    offset: Floats


def common_similarity(first: Poses, second: Poses) -> Similarity:
    """Align two worlds by the poses of the same photos, as suits most of them."""
    # Each photo gives a turn, R_second^T R_first.
    turns = np.einsum("nji,njk->nik", second.rotation, first.rotation)
    between = angle(np.einsum("mji,njk->mnik", turns, turns))
    near = between <= SAME
    spread = np.where(near, between, 0.0).sum(1)
    agree = near[np.lexsort((spread, -near.sum(1)))[0]]
    left, _, right = np.linalg.svd(turns[agree].mean(0))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return Similarity(turn, *_common_scale(first.centre @ turn.T, second.centre, agree))


def differences(first: Poses, second: Poses) -> dict[str, PoseDifference]:
    """Compare the photos that both have, after the alignment that suits most of them, by name."""
    common = [name for name in first.names if name in set(second.names)]
    if len(common) < 2:
        return {}
    first, second = first.chosen(common), second.chosen(common)
    between = common_similarity(first, second)
    turned = np.einsum("nij,kj->nik", first.rotation, between.turn)
    angles = angle(np.einsum("nij,nkj->nik", second.rotation, turned))
    moved = between.scale * first.centre @ between.turn.T + between.offset
    away = np.linalg.norm(moved - second.centre, axis=1)
    shift = np.degrees(np.arctan2(away, second.depth))
    return {
        name: PoseDifference(float(a), float(b))
        for name, a, b in zip(common, angles, shift, strict=True)
    }


def angle(rotation: Floats) -> Floats:
    """Compute angles (...) of rotation matrices (..., 3, 3), degrees; exact for small ones, too."""
    skew = rotation - np.swapaxes(rotation, -1, -2)
    sine = np.sqrt((skew**2).sum((-1, -2)) / 8)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))


def _common_scale(
    first: Floats, second: Floats, agree: npt.NDArray[np.bool_]
) -> tuple[float, Floats]:
    """Fit scale and offset (3,) from ``first`` (N, 3) to ``second``, by the photos that agree.

    The first fit uses medians; the others are least squares without the photos that are far off.
    """
    a, b = first[agree], second[agree]
    near = np.ones(len(a), bool)
    middle: Callable[..., Any] = np.median
    for _ in range(ROUNDS):
        from_a, from_b = a - middle(a[near], axis=0), b - middle(b[near], axis=0)
        size = np.linalg.norm(from_a, axis=1), np.linalg.norm(from_b, axis=1)
        scale = float(middle(size[1][near]) / max(float(middle(size[0][near])), 1e-300))
        away = np.linalg.norm(scale * from_a - from_b, axis=1)
        near = away <= OFF * max(float(np.median(away)), 1e-9 * float(size[1].max()))
        middle = np.mean
    return scale, np.asarray(b[near].mean(0) - scale * a[near].mean(0))
