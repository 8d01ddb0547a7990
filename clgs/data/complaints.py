"""Warnings about the photos of a data set, before they are read.

Among other things they name cameras that are far from all others: most often their poses are wrong.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.posed_photo import PhotoSet
from clgs.data.reduction import MEANINGS, OBJECT, Reduction
from clgs.errors import DataError

Floats = npt.NDArray[np.float64]

LEAST = 5
"""Fewer cameras do not show what is usual."""

APART, ASTRAY = 5.0, 20.0
"""Multiples of the median distance from the middle of all cameras. A camera beyond
the first is worth a look; one beyond the second has a wrong pose.
"""

ALONE = 0.5
"""A camera is lonely if it is at least this share of its distance from the middle away from all
others."""


def spread(centres: Floats) -> tuple[Floats, float]:
    """Distances (N,) of cameras from their median centre, and the median of these.

    Args:
        centres: (N, 3), N at least 1, world units.
    """
    distance = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    return distance, float(np.median(distance))


def in_one_place(centres: Floats) -> bool:
    """Whether most cameras are at their median centre, so that photos show no depth."""
    _, usual = spread(centres)
    return not usual > 1e-9 * (1.0 + float(np.abs(centres).max()))


def apart(centres: Floats, times: float) -> npt.NDArray[np.bool_]:
    """Which cameras (N,) are more than ``times`` the median distance from the middle of all.

    None of fewer than LEAST cameras, nor of cameras that are mostly in one place.
    """
    distance, usual = spread(centres)
    enough = len(centres) >= LEAST and not in_one_place(centres)
    return np.asarray((distance > times * usual) & enough)


def lonely(centres: Floats) -> npt.NDArray[np.bool_]:
    """Which cameras (N,) are worth a look: far from the middle and from all others.

    A photographer who walks away from the others' place is never far from the previous photo.
    Cameras beyond ASTRAY count even if there are several of them.
    """
    distance, _ = spread(centres)
    found = apart(centres, APART)
    for i in np.flatnonzero(found):
        others = np.delete(centres, i, axis=0)
        found[i] = np.linalg.norm(others - centres[i], axis=1).min() > ALONE * distance[i]
    return found | apart(centres, ASTRAY)


NONE_LEFT = "all photos are held out, none is left to train on; --test-every 0 holds none out"

NAMED = 8
"""A warning names at most this many photos."""

_log = logging.getLogger(__name__)


def check_photos(root: Path, photos: PhotoSet, reduction: Reduction) -> None:
    """Warn of missing photos, several models and cameras in one place.

    Raises:
        DataError: no photo to train on, or a reduction that leaves none of their pixels.
    """
    if missing := photos.missing:
        total = len(missing) + len(photos.train) + len(photos.test)
        named = _named(missing)
        _log.warning("%s: %d of %d photos are missing: %s", root, len(missing), total, named)
    if models := photos.models_in_words():
        _log.warning("%s: %s", root, models)
    if not photos.train:
        raise DataError(f"{root}: {NONE_LEFT}")
    everyone = photos.train + photos.test
    if outside := [photo for photo in everyone if not photo.lens.holds_its_centre]:
        lens, named = outside[0].lens, _named([photo.name for photo in outside])
        _log.warning(
            "%s: the centre of the lens, %g %g, lies outside of %d photos: %s; correct cx, cy, "
            "unless they were cut out of larger photos",
            *(root, lens.cx, lens.cy, len(outside), named),
        )
    centres = np.array([photo.centre for photo in photos.train])
    if len(centres) > 1 and in_one_place(centres):
        problem = "all cameras are in one place, so depth cannot be seen; walk, not turn"
        _log.warning("%s: %s", root, problem)
    if not isinstance(reduction.times, int) or reduction.times < 0:
        problem = f"downscale is {reduction.times}; give a whole number of at least 1"
        raise DataError(f"{problem}, or 0 for the width alone")
    least = min(min(p.lens.width, p.lens.height) for p in everyone)
    if reduction.times > least:
        raise DataError(
            f"downscale is {reduction.times}; the photos are {least} pixels, give at most that"
        )


def check_masks(root: Path, photos: PhotoSet, masks: str) -> None:
    """Raise DataError unless ``masks`` is known; warn of photos without mask and masks without."""
    if masks not in MEANINGS:
        raise DataError(f"masks is {masks!r}; give {' or '.join(MEANINGS)}")
    without = [photo.name for photo in photos.train + photos.test if photo.mask is None]
    if masks == OBJECT and without:
        _log.warning(
            "%s: %d photos have no mask, so that all that they show is the object: %s",
            *(root, len(without), _named(without)),
        )
    if photos.stray_masks:
        _log.warning(
            "%s: %d files look like masks, but are those of no photo and are not used: %s; call "
            "them NAME.png as the photos are, in the folder masks",
            *(root, len(photos.stray_masks), _named(photos.stray_masks)),
        )


def _named(names: list[str]) -> str:
    shown = [name[:80] if name.isprintable() else repr(name[:80]) for name in names[:NAMED]]
    return ", ".join(shown) + ", ..." * (len(names) > NAMED)


def find_astray(root: Path, photos: PhotoSet) -> npt.NDArray[np.bool_]:
    """Which training cameras (N,) are so far away that their poses must be wrong.

    There is a warning about them, and about such cameras of test photos.
    """
    everyone = photos.train + photos.test
    astray = apart(np.array([photo.centre for photo in everyone]), ASTRAY)
    if astray.any():
        names = [photo.name for photo, far in zip(everyone, astray, strict=True) if far]
        _log.warning(
            "%s: more than %d times as far from the middle as half of the cameras, so their poses "
            "are wrong: %s; leave these photos out",
            *(root, ASTRAY, _named(names)),
        )
    return astray[: len(photos.train)]
