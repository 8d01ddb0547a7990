"""Cameras: their lenses (distortion, principal point, focal length) and their poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from clgs.data.complaints import APART, LEAST, in_one_place, lonely, spread
from clgs.data.lens import Lens, undistort_lens
from clgs.data.posed_photo import Photo
from clgs.doctor import ERROR, NOTE, WARNING, Finding, named
from clgs.errors import DataError
from clgs.scene.camera import optical_axes

Floats = npt.NDArray[np.float64]

OFF_CENTRE = 0.1
"""Share of the width or height; a principal point further from the middle means cropping."""

LOST = 0.25
"""Share of the pixels that are lost when the distortion is taken out, above which to warn."""

UNEVEN = 0.02
"""Pixels whose sides differ by more are rare."""

FIELD_OF_VIEW = 10.0, 140.0
"""Degrees across that photos usually have."""

FEW = 20
"""Fewer photos leave holes in most scenes."""

SAME = 1e-6
"""Poses closer than this share of the cameras' median distance are the same."""

LEVEL, TIPPED = 10.0, 35.0
"""Degrees of roll. If half of the cameras are below the first, none should exceed the second."""

INWARD, AWAY = 35.0, 95.0
"""Degrees to the point that most look at. If half are below the first, others look away."""


def check_lenses(photos: list[Photo]) -> Iterator[Finding]:
    """One finding per fault: the photos that have it, and the figures of the first of them."""
    found: dict[tuple[str, str], tuple[str, list[str]]] = {}
    known: dict[Lens, list[tuple[str, str, str]]] = {}
    for photo in photos:
        if photo.lens not in known:
            known[photo.lens] = [*_distortion(photo.lens), *_centre(photo.lens)]
            known[photo.lens] += _focal(photo.lens)
        for level, problem, remedy in known[photo.lens]:
            found.setdefault((level, remedy), (problem, []))[1].append(photo.name)
    lenses: dict[str, Lens] = {photo.name: photo.lens for photo in photos}
    for (level, remedy), (problem, names) in found.items():
        alike = len({lenses[name] for name in names}) > 1
        yield Finding(level, named(names), problem + " (the first)" * alike, remedy)


def _distortion(lens: Lens) -> Iterator[tuple[str, str, str]]:
    if not lens.distorted:
        return
    try:
        pinhole, _ = undistort_lens(lens)
    except DataError as error:
        yield ERROR, str(error), "correct k1, k2, p1, p2, or calibrate again"
        return
    lost = 1.0 - pinhole.width * pinhole.height / (lens.width * lens.height)
    kind = "a fisheye" if lens.fisheye else "a distorted lens"
    problem = f"{kind}: {pinhole.width}x{pinhole.height} of {lens.width}x{lens.height} remain"
    if lost > LOST:
        yield WARNING, problem, "check k1, k2, p1, p2: this much is rarely lost"
    else:
        yield NOTE, problem, "nothing to do: it is taken out when photos are read"


def _centre(lens: Lens) -> Iterator[tuple[str, str, str]]:
    off = max(abs(lens.cx / lens.width - 0.5), abs(lens.cy / lens.height - 0.5))
    if off > OFF_CENTRE:
        problem = f"principal point ({lens.cx:.1f}, {lens.cy:.1f}) of {lens.width}x{lens.height}"
        remedy = "correct cx, cy; they go with w, h of the same photo, and cropping moves them"
        yield WARNING, f"{problem} is {off:.0%} off the middle", remedy


def _focal(lens: Lens) -> Iterator[tuple[str, str, str]]:
    angle = float(np.degrees(2 * np.arctan(lens.width / (2 * lens.fx))))
    least, most = FIELD_OF_VIEW
    if not (least <= angle <= most) and not lens.fisheye:
        problem = f"focal length {lens.fx:.1f} pixels, that is {angle:.1f} degrees across"
        yield WARNING, problem, "correct fl_x; it goes with w of the same photo"
    if abs(lens.fx / lens.fy - 1.0) > UNEVEN:
        problem = f"fx is {lens.fx:.1f} and fy {lens.fy:.1f}: pixels are not square"
        yield WARNING, problem, "correct them, unless the photo was stretched"


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
            WARNING, "", "all cameras are in one place, so depth cannot be seen", "walk, not turn"
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
    """Findings of photos that share a pose; ``centres`` are in units of the median distance."""
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
    """Which cameras (N,) are tilted while most are level.

    The x axes of level cameras lie in one plane, and its normal is the upward axis.
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
    """Which cameras (N,) look away from the point nearest to all axes, if most look at it."""
    axes = np.array([photo.rotation[2] for photo in photos])
    matrix, right = optical_axes(centres, axes)
    if np.linalg.eigvalsh(matrix)[0] < 1e-3:
        return np.zeros(len(photos), bool)
    towards = np.linalg.solve(matrix, right) - centres
    cosine = np.sum(towards * axes, axis=1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-300)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.asarray((angle > AWAY) & (np.median(angle) < INWARD))
