"""What a short training on all photos says of each: a photo that it cannot show is in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from clgs.poses.judging.verdict import DOUBTFUL, GOOD, PhotoVerdict, Verdict

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
    photos = tuple(_judged(photo, unexplained.get(photo.name), usual) for photo in verdict.photos)
    count = sum(any(one.startswith(REASON) for one in photo.reasons) for photo in photos)
    sure = verdict.sure
    if count and sure.startswith("sure:"):
        sure = f"mostly {sure}"
    return replace(verdict, photos=photos, sure=sure + _remark(count, len(unexplained), usual))


def untrained(verdict: Verdict) -> Verdict:
    """The verdict, if the short training could not be made."""
    return replace(verdict, sure=f"{verdict.sure}; not tested by a short training")


def _judged(photo: PhotoVerdict, share: float | None, usual: float) -> PhotoVerdict:
    if share is None:
        return photo
    photo = replace(photo, unexplained=share)
    if share <= max(MOST, TIMES * usual):
        return photo
    reason = f"{REASON}: {share:.0%} of it is unexplained, {usual:.0%} of most"
    return replace(
        photo,
        status=DOUBTFUL if photo.status == GOOD else photo.status,
        reasons=(*photo.reasons, reason),
        remedy=photo.remedy or REMEDY,
    )


def _remark(count: int, total: int, usual: float) -> str:
    """What is added to the sentence on the whole."""
    if usual > MOST:
        return "; a short training hardly shows the photos: poses or exposures may be wrong"
    if count:
        return f"; a short training does not show {count} of {total} photos"
    return "; a short training shows every photo"
