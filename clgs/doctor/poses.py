"""Poses: twice the same, apart from the rest, tipped on the side, looking away."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from clgs.data.apart import APART, LEAST, in_one_place, lonely, spread
from clgs.data.posed_photo import Photo
from clgs.doctor.finding import ERROR, NOTE, WARNING, Finding, named

Floats = npt.NDArray[np.float64]

FEW = 20
"""Fewer photos leave holes in most scenes."""

SAME = 1e-6
"""Poses closer than this, relative to the cameras' median distance, are one."""

LEVEL, TIPPED = 10.0, 35.0
"""Degrees of roll that half of the cameras stay below, and that none should exceed then."""

INWARD, AWAY = 35.0, 95.0
"""Degrees to the point that most look at: half below the first, and who is above the second."""


def check_poses(photos: list[Photo]) -> Iterator[Finding]:
    """Findings of all poses."""
    if len(photos) < 2:
        problem = "one photo is too few to train on" if photos else "there is no photo"
        yield Finding(ERROR, "", problem, "give at least two; 50 to 200 are usual")
        return
    if len(photos) < FEW:
        problem = f"{len(photos)} photos are few"
        yield Finding(NOTE, "", problem, "take more if the result has holes; 50 to 200 are usual")
    centres = np.array([photo.centre for photo in photos])
    names = [photo.name for photo in photos]
    if in_one_place(centres):
        yield Finding(
            WARNING, "", "all cameras are in one place, so no depth can be told", "walk, not turn"
        )
        return
    yield from _same(photos, centres / spread(centres)[1])
    if len(photos) < LEAST:
        return
    yield from _warn(
        [name for name, far in zip(names, lonely(centres), strict=True) if far],
        f"more than {APART:.0f} times as far from the middle as half of the cameras",
        "look at the cameras (clgs export DATA -o cameras.glb); leave these out if they are wrong",
    )
    yield from _warn(
        [name for name, tips in zip(names, _tipped(photos), strict=True) if tips],
        "tipped on the side, unlike the others",
        "if it was not held so, its pose is wrong: leave it out, or prepare again",
    )
    yield from _warn(
        [name for name, away in zip(names, _looks_away(photos, centres), strict=True) if away],
        "looks away from what the others look at",
        "if it was not taken so, its pose is wrong: leave it out, or prepare again",
    )


def _warn(names: list[str], problem: str, remedy: str) -> Iterator[Finding]:
    if names:
        yield Finding(WARNING, named(names), problem, remedy)


def _same(photos: list[Photo], centres: Floats) -> Iterator[Finding]:
    """Photos that share a pose; ``centres`` in units of the median distance."""
    rows = [
        np.concatenate([centre, photo.rotation.ravel()])
        for photo, centre in zip(photos, centres, strict=True)
    ]
    cells: dict[bytes, list[str]] = {}
    for photo, row in zip(photos, rows, strict=True):
        key = np.rint(row / SAME).astype(np.int64).tobytes()
        cells.setdefault(key, []).append(photo.name)
    for names in cells.values():
        if len(names) > 1:
            problem = f"{len(names)} photos have one pose"
            yield Finding(WARNING, named(names), problem, "keep one of them, or correct the poses")


def _tipped(photos: list[Photo]) -> npt.NDArray[np.bool_]:
    """Whose horizon is tilted while those of most are level, (N,).

    Level cameras' x axes lie in one plane whatever they look at; its normal is the upward axis.
    """
    right, up = (np.array([sign * p.rotation[i] for p in photos]) for i, sign in ((0, 1), (1, -1)))
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    axis = vectors[:, 0]
    if values[1] < 0.02:  # all look one way: the plane is not known
        axis = np.median(up, axis=0) / max(float(np.linalg.norm(np.median(up, axis=0))), 1e-9)
    if np.median(up @ axis) < 0:
        axis = -axis
    roll = np.degrees(np.arcsin(np.clip(np.abs(right @ axis), 0.0, 1.0)))
    roll[up @ axis < -0.3] = 180.0
    return np.asarray((roll > TIPPED) & (np.median(roll) < LEVEL))


def _looks_away(photos: list[Photo], centres: Floats) -> npt.NDArray[np.bool_]:
    """Who looks away from the point nearest to all axes, if most look at it, (N,)."""
    axes = np.array([photo.rotation[2] for photo in photos])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < 1e-3 * len(photos):
        return np.zeros(len(photos), bool)
    focus = np.linalg.solve(total, np.einsum("nij,nj->i", across, centres))
    towards = focus - centres
    cosine = np.sum(towards * axes, axis=1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-300)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.asarray((angle > AWAY) & (np.median(angle) < INWARD))
