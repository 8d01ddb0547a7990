"""The evidence for poses: verified matches between photos, and what models explain of them.

How far two reconstructions of the same photos differ is evidence, too, photo by photo.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

MAX_ERROR = 4.0
"""A match is explained up to this distance from its epipolar line, pixels; COLMAP's default."""

MIN_MATCHES = 15
"""Pairs with fewer verified matches are ignored, as in COLMAP."""

LINKS = 4
"""The pairs with the most matches of a photo, its links: they speak for or against a model.

Repeated things match everywhere, but never as well as neighbours do. All pairs together would
prefer the model that lays equal sides of the scene onto each other.
"""

STRONG_PAIR, CONTRADICTED = 30, 0.3
"""A pair with this number of matches contradicts the poses that explain less than this share."""

STILL = 2.0
"""A match that moves by at most this many pixels shows something that stands still in the picture.
"""

MAX_CONTRADICTED = 0.03
"""Above this share of matches in contradicting links the photos fit together in other ways, too."""


@dataclass(frozen=True)
class MatchedPair:
    """The numbers of two images, and verified matches (M, 2) of their features."""

    first: int
    second: int
    matches: npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Evidence:
    """All verified pairs; keypoints: pixels (K, 2) by the image's number."""

    pairs: list[MatchedPair]
    keypoints: dict[int, Floats]

    @property
    def links(self) -> list[MatchedPair]:
        """The pairs that speak for or against a model."""
        return self.strongest(LINKS)

    def strongest(self, most: int) -> list[MatchedPair]:
        """Choose the pairs that are among the ``most`` best matched ones of one of their photos."""
        order = sorted(self.pairs, key=lambda pair: -len(pair.matches))
        used: Counter[int] = Counter()
        found = []
        for pair in order:
            if min(used[pair.first], used[pair.second]) < most:
                found.append(pair)
            used.update((pair.first, pair.second))
        return found

    @property
    def still(self) -> float:
        """The share of all matches that stand still, as the background of a turntable does."""
        moved = [
            np.linalg.norm(
                self.keypoints[pair.first][pair.matches[:, 0]]
                - self.keypoints[pair.second][pair.matches[:, 1]],
                axis=1,
            )
            for pair in self.pairs
        ]
        return float(np.mean(np.concatenate(moved) <= STILL)) if moved else 0.0


@dataclass(frozen=True)
class Explained:
    """How many matches of the links a model explains.

    links: L pairs; matches: (L,) their verified matches; explained: (L,) those that the model
    explains, -1 if a photo has no pose.
    """

    links: list[MatchedPair]
    matches: npt.NDArray[np.int64]
    explained: npt.NDArray[np.int64]

    @property
    def total(self) -> int:
        """The matches that the model explains: the more, the better the model."""
        return int(np.maximum(self.explained, 0).sum())

    @property
    def contradicted(self) -> float:
        """The share of the links' matches that are in links which the poses do not explain."""
        strong = (self.matches >= STRONG_PAIR) & (self.explained >= 0)
        bad = self.explained < CONTRADICTED * self.matches
        return float(self.matches[strong & bad].sum() / max(int(self.matches[strong].sum()), 1))

    def without(self, photos: set[int]) -> Explained:
        """Select the links between other photos than these, given by number."""
        rest = np.array([not {one.first, one.second} & photos for one in self.links], np.bool_)
        links = [one for one, kept in zip(self.links, rest, strict=True) if kept]
        return Explained(links, self.matches[rest], self.explained[rest])

    def inlier_ratios(self) -> dict[int, float]:
        """Compute the share of each photo's matches in links that the poses explain, by number."""
        total: Counter[int] = Counter()
        good: Counter[int] = Counter()
        counts = zip(self.links, self.matches.tolist(), self.explained.tolist(), strict=True)
        for pair, matches, count in counts:
            if count >= 0:
                for number in (pair.first, pair.second):
                    total[number] += matches
                    good[number] += count
        return {number: good[number] / total[number] for number in total}


@dataclass(frozen=True)
class MappedModel:
    """A pycolmap reconstruction, the mapper that made it, and the matches that it explains."""

    mapper: str
    reconstruction: Any
    explained: Explained


@dataclass(frozen=True)
class ModelChoice:
    """The model that is kept, and the evidence for it.

    candidates: the largest model of each mapper; apart: the photos' names of each smaller model of
    the kept one's mapper; found: all models of each mapper that was asked.
    """

    kept: MappedModel
    candidates: list[MappedModel]
    evidence: Evidence
    apart: list[list[str]]
    found: Mapping[str, list[Any]] = field(default_factory=dict)


def explain(model: Any, evidence: Evidence) -> Explained:
    """Count the matches of each link that agree with the poses of pycolmap's ``model``."""
    links = evidence.links
    images = {number: model.image(number) for number in model.reg_image_ids()}
    # The features in focal lengths, without distortion, (K, 2).
    rays = {
        number: np.asarray(
            image.camera.cam_from_img(evidence.keypoints[number]), np.float64
        ).reshape(-1, 2)
        for number, image in images.items()
    }
    counts = []
    for pair in links:
        if not {pair.first, pair.second} <= images.keys():
            counts.append(-1)
            continue
        both = images[pair.first], images[pair.second]
        poses = [image.cam_from_world() for image in both]
        first, second = (np.asarray(pose.rotation.matrix()) for pose in poses)
        rotation = second @ first.T
        translation = poses[1].translation - rotation @ poses[0].translation
        left, right = rays[pair.first][pair.matches[:, 0]], rays[pair.second][pair.matches[:, 1]]
        focal = np.mean([image.camera.mean_focal_length() for image in both])
        error = sampson_error(rotation, translation, left, right)
        counts.append(int((error * focal <= MAX_ERROR).sum()))
    matches = [len(pair.matches) for pair in links]
    return Explained(links, np.array(matches, np.int64), np.array(counts, np.int64))


def sampson_error(rotation: Floats, translation: Floats, left: Floats, right: Floats) -> Floats:
    """Compute the distance (M,) of points (M, 2), in focal lengths, from agreeing with a pose.

    It is the second camera's relative to the first, (3, 3) and (3,); of any length but zero.
    """
    x, y, z = translation
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    left = np.column_stack([left, np.ones(len(left))])
    right = np.column_stack([right, np.ones(len(right))])
    line_right, line_left = left @ essential.T, right @ essential
    residual = np.abs(np.einsum("ij,ij->i", right, line_right))
    slope = np.hypot(
        np.hypot(line_right[:, 0], line_right[:, 1]), np.hypot(line_left[:, 0], line_left[:, 1])
    )
    return np.asarray(residual / np.maximum(slope, 1e-300))


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
