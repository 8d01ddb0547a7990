"""A second reconstruction from half of the points: what both agree on can be trusted.

Which half a feature belongs to is drawn by its point in the first reconstruction, so that a track
is never split; matches without a point are drawn one by one. The first reconstruction's poses play
no part. A photo whose pose rests on little, or on matches that contradict each other, comes to
stand elsewhere.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.poses.job import Job
from clgs.poses.judging.evidence import MIN_MATCHES, Evidence
from clgs.poses.models import GLOBAL, INCREMENTAL, Model, choose

SHARE = 0.5
"""Of all tracks."""

OTHER_SEED = 1_000_003
"""Added to the seed: the second reconstruction must not follow the first one's choices."""


def reconstruct_half(job: Job, kept: Model, evidence: Evidence) -> Any | None:
    """The best model of half of the tracks by the same mapper; None if nothing came of it."""
    seed = (job.seed + OTHER_SEED) % 2**31
    folder = job.folder / "check"
    folder.mkdir()
    half = replace(job, folder=folder, seed=seed)
    _write_half(job, half, _halves(kept.reconstruction, evidence, seed), evidence)
    mapper = GLOBAL if kept.mapper == GLOBAL else INCREMENTAL
    choice = choose(half, (mapper,), "check")
    return choice.kept.reconstruction if choice else None


def _halves(model: Any, evidence: Evidence, seed: int) -> dict[int, npt.NDArray[np.int8]]:
    """For every feature of an image 1 or 0, the half of its track; -1 without a track."""
    rng = np.random.default_rng(seed)
    side = {number: int(rng.random() < SHARE) for number in sorted(model.point3D_ids())}
    halves = {}
    for number, keypoints in evidence.keypoints.items():
        half = np.full(len(keypoints), -1, np.int8)
        if model.exists_image(number):
            for index, point in enumerate(model.image(number).points2D):
                if point.has_point3D():
                    half[index] = side[point.point3D_id]
        halves[number] = half
    return halves


def _write_half(
    job: Job, half: Job, halves: dict[int, npt.NDArray[np.int8]], evidence: Evidence
) -> None:
    """The database of the second reconstruction: the same features, half of the matches."""
    rng = np.random.default_rng(half.seed)
    shutil.copyfile(job.database, half.database)
    with (
        job.open() as whole,
        half.open() as part,
    ):
        part.clear_descriptors()
        part.clear_matches()
        part.clear_two_view_geometries()
        for pair in evidence.pairs:
            first = halves[pair.first][pair.matches[:, 0]]
            second = halves[pair.second][pair.matches[:, 1]]
            drawn = (rng.random(len(first)) < SHARE).astype(np.int8)
            side = np.where(first >= 0, first, np.where(second >= 0, second, drawn))
            kept = pair.matches[side == 1]
            if len(kept) >= MIN_MATCHES:
                geometry = whole.read_two_view_geometry(pair.first, pair.second)
                geometry.inlier_matches = kept
                part.write_matches(pair.first, pair.second, kept)
                part.write_two_view_geometry(pair.first, pair.second, geometry)
