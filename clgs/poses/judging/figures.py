"""Figures of every photo of a reconstruction, from which it is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clgs.poses.judging.agreement import Floats, Poses, angle
from clgs.poses.judging.evidence import Explained


@dataclass(frozen=True)
class Figures:
    """Of a photo, as of :class:`clgs.poses.judging.verdict.PhotoVerdict`.

    steps: degrees from the neighbours by name, one or two of them.
    """

    observations: int
    inlier_ratio: float
    track_length: float
    error: float
    tilt: float
    steps: tuple[float, ...]


def figures(model: Any, poses: Poses, explained: Explained) -> dict[str, Figures]:
    """Of each photo with a pose in a pycolmap reconstruction, by name."""
    ratio = inlier_ratios(explained)
    tilts, steps = tilt(poses), steps_by_name(poses)
    found = {}
    for place, name in enumerate(poses.names):
        image = model.find_image_with_name(name)
        seen = [(p.point3D_id, p.xy) for p in image.points2D if p.has_point3D()]
        points = [model.point3D(number) for number, _ in seen]
        length = np.mean([p.track.length() for p in points]) if points else 0.0
        error = _error(image, np.array([p.xyz for p in points]), np.array([xy for _, xy in seen]))
        share = ratio.get(image.image_id, 0.0)
        found[name] = Figures(
            len(points), share, float(length), error, float(tilts[place]), steps[place]
        )
    return found


def inlier_ratios(explained: Explained) -> dict[int, float]:
    """By image number, the share of its matches in links that the poses explain."""
    total: dict[int, int] = {}
    good: dict[int, int] = {}
    counts = zip(
        explained.links, explained.matches.tolist(), explained.explained.tolist(), strict=True
    )
    for pair, matches, count in counts:
        if count >= 0:
            for number in (pair.first, pair.second):
                total[number] = total.get(number, 0) + matches
                good[number] = good.get(number, 0) + count
    return {number: good[number] / total[number] for number in total}


def tilt(poses: Poses) -> Floats:
    """Degrees (N,) between each photo's up-vector and the median of all."""
    up = -poses.rotation[:, 1]
    # The direction with the least sum of angles to the others is one of them, nearly.
    between = np.degrees(np.arccos(np.clip(up @ up.T, -1.0, 1.0)))
    return np.asarray(between[between.sum(1).argmin()])


def steps_by_name(poses: Poses) -> list[tuple[float, ...]]:
    """Degrees by which each photo is turned against the one before and the one after."""
    turned = np.einsum("nij,nkj->nik", poses.rotation[1:], poses.rotation[:-1])
    step = angle(turned).tolist()
    return [tuple(step[max(i - 1, 0) : i + 1]) for i in range(len(poses.names))]


def _error(image: Any, points: Floats, pixels: Floats) -> float:
    """Mean reprojection error in pixels."""
    if not len(points):
        return 0.0
    pose = image.cam_from_world()
    local = points @ np.asarray(pose.rotation.matrix()).T + pose.translation
    projected = np.asarray(image.camera.img_from_cam(local, check_cheirality=False))
    return float(np.linalg.norm(projected - pixels, axis=1).mean())
