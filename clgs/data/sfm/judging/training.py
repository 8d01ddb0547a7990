"""What a short training on all photos says of each: a photo that it cannot show is in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from clgs.data.sfm.judging.verdict import DOUBTFUL, GOOD, PhotoVerdict, Verdict

MOST, TIMES = 0.5, 3.0
"""A photo is in doubt if more of its variance is unexplained, and this many times the median."""

REASON = "a short training shows the other photos, and not this one"
REMEDY = (
    "if something stands before the camera that no other photo shows, mask it "
    "(masks/NAME.png); else the pose is wrong, remove the photo"
)


def with_training(verdict: Verdict, unexplained: Mapping[str, float]) -> Verdict:
    """The verdict, with what a short training found.

    Args:
        verdict: of the reconstruction.
        unexplained: share of the variance of each photo, by name, that the training does not show.
    """
    if not unexplained:
        return verdict
    usual = float(np.median(list(unexplained.values())))
    limit = max(MOST, TIMES * usual)
    photos = tuple(_judged(photo, unexplained.get(photo.name), limit) for photo in verdict.photos)
    count = sum(REASON in photo.reasons for photo in photos)
    return replace(verdict, photos=photos, sure=verdict.sure + _remark(count, usual))


def _judged(photo: PhotoVerdict, share: float | None, limit: float) -> PhotoVerdict:
    if share is None:
        return photo
    photo = replace(photo, unexplained=share)
    if share <= limit:
        return photo
    return replace(
        photo,
        status=DOUBTFUL if photo.status == GOOD else photo.status,
        reasons=(*photo.reasons, REASON),
        remedy=photo.remedy or REMEDY,
    )


def _remark(count: int, usual: float) -> str:
    """What is added to the sentence on the whole."""
    if usual > MOST:
        return "; but a short training hardly shows the photos: poses or exposures may be wrong"
    if count:
        return f"; but a short training does not show {count} of them"
    return "; a short training shows every photo"
