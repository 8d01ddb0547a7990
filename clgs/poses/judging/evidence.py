"""The evidence for poses: verified matches between photos, and what models explain of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
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
