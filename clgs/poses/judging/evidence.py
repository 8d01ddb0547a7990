"""Whether a model explains the matches that were verified between pairs of photos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.poses.job import Job
from clgs.poses.judging.epipolar import Floats, sampson_error

MAX_ERROR = 4.0
"""Pixels off the epipolar line at which the model's poses explain a match; COLMAP's default."""

MIN_MATCHES = 15
"""Pairs with fewer verified matches count for nothing, as in COLMAP."""


LINKS = 4
"""Pairs of a photo that speak for or against a model: those of the most matches.

Repeated things match everywhere, if never as well as neighbours do: all pairs together would prefer
the model that lays equal sides of the scene onto each other.
"""

STRONG_PAIR, CONTRADICTED = 30, 0.3
"""A pair of so many matches contradicts the poses if they explain less than this share."""

STILL = 2.0
"""Pixels that a match moves by at most if what it shows stands still in the picture."""

MAX_CONTRADICTED = 0.03
"""Above this share of matches in contradicting links the photos fit together in other ways, too."""


@dataclass(frozen=True)
class Pair:
    """Numbers of two images, and verified matches (M, 2) of their features."""

    first: int
    second: int
    matches: npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Evidence:
    """pairs; keypoints: pixels (K, 2) by the image's number."""

    pairs: list[Pair]
    keypoints: dict[int, Floats]

    @property
    def links(self) -> list[Pair]:
        """The pairs that speak for or against a model."""
        return self.strongest(LINKS)

    def strongest(self, most: int) -> list[Pair]:
        """The pairs that are among the ``most`` of most matches of one of their photos."""
        order = sorted(self.pairs, key=lambda pair: -len(pair.matches))
        used: dict[int, int] = {}
        found = []
        for pair in order:
            counts = [used.get(number, 0) for number in (pair.first, pair.second)]
            if min(counts) < most:
                found.append(pair)
            used |= {pair.first: counts[0] + 1, pair.second: counts[1] + 1}
        return found

    @property
    def still(self) -> float:
        """Share of all matches that stand still, as what is behind a turntable does."""
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
    """links, and for each (L,): verified matches, and those a model explains; -1 without poses."""

    links: list[Pair]
    matches: npt.NDArray[np.int64]
    explained: npt.NDArray[np.int64]

    @property
    def total(self) -> int:
        """Matches that the model explains: the more, the better the model."""
        return int(np.maximum(self.explained, 0).sum())

    @property
    def contradicted(self) -> float:
        """Share of the links' matches that are in links which the poses do not explain."""
        strong = (self.matches >= STRONG_PAIR) & (self.explained >= 0)
        bad = self.explained < CONTRADICTED * self.matches
        return float(self.matches[strong & bad].sum() / max(int(self.matches[strong].sum()), 1))

    def without(self, photos: set[int]) -> Explained:
        """The links between other photos than these, by number."""
        rest = np.array([not {one.first, one.second} & photos for one in self.links], np.bool_)
        links = [one for one, kept in zip(self.links, rest, strict=True) if kept]
        return Explained(links, self.matches[rest], self.explained[rest])


def read_evidence(job: Job) -> Evidence:
    """All verified pairs of the database."""
    with job.open() as database:
        keypoints = {
            number: np.asarray(database.read_keypoints(number), np.float64)[:, :2]
            for number in job.ids(database)
        }
        numbers, geometries = database.read_two_view_geometries()
    pairs = []
    for number, geometry in zip(numbers, geometries, strict=True):
        matches = np.asarray(geometry.inlier_matches, np.uint32).reshape(-1, 2)
        if len(matches) >= MIN_MATCHES:
            first, second = job.pycolmap.pair_id_to_image_pair(number)
            pairs.append(Pair(first, second, matches))
    return Evidence(pairs, keypoints)


def explain(model: Any, evidence: Evidence) -> Explained:
    """How many matches of each link agree with a pycolmap reconstruction's poses and lenses."""
    links = evidence.links
    rays = {number: _rays(model, number, evidence) for number in model.reg_image_ids()}
    found = [
        _explained(model, pair, rays) if {pair.first, pair.second} <= rays.keys() else -1
        for pair in links
    ]
    matches = [len(pair.matches) for pair in links]
    return Explained(links, np.array(matches, np.int64), np.array(found, np.int64))


def _rays(model: Any, number: int, evidence: Evidence) -> Floats:
    """The image's features in focal lengths, without distortion, (K, 2)."""
    camera = model.image(number).camera
    return np.asarray(camera.cam_from_img(evidence.keypoints[number]), np.float64).reshape(-1, 2)


def _explained(model: Any, pair: Pair, rays: dict[int, Floats]) -> int:
    images = [model.image(number) for number in (pair.first, pair.second)]
    poses = [image.cam_from_world() for image in images]
    first, second = (np.asarray(pose.rotation.matrix()) for pose in poses)
    rotation = second @ first.T
    translation = poses[1].translation - rotation @ poses[0].translation
    left, right = rays[pair.first][pair.matches[:, 0]], rays[pair.second][pair.matches[:, 1]]
    focal = np.mean([image.camera.mean_focal_length() for image in images])
    error = sampson_error(rotation, translation, left, right)
    return int((error * focal <= MAX_ERROR).sum())
