"""Removal of doubtful photos from a finished data set: their files, and the points they carry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from clgs.data.masks import MASKS
from clgs.errors import DataError
from clgs.poses.pycolmap_child import OnStage, quiet_pycolmap, run_child
from clgs.poses.verdict import DOUBTFUL, GOOD, LEFT_OUT, Verdict, point_figures

LEAST_GOOD = 3
"""The least photos of a data set."""

_TASK = "leaving out photos"


def drop_doubtful(target: Path, verdict: Verdict) -> Verdict:
    """Remove the photos in doubt from the data set in ``target``; returns the verdict on the rest.

    Raises:
        DataError: too few would be left.
    """
    names = [photo.name for photo in verdict.of(DOUBTFUL)]
    if not names:
        return verdict
    good = len(verdict.of(GOOD))
    if good < LEAST_GOOD:
        raise DataError(
            f"only {good} of {verdict.total} photos are not in doubt, {LEAST_GOOD} are needed; "
            "take more, overlapping photos, or keep those in doubt"
        )
    figures = run_child(__name__, _TASK, [str(target), names], lambda stage: None)
    photos = tuple(
        replace(photo, status=LEFT_OUT) if photo.status == DOUBTFUL else photo
        for photo in verdict.photos
    )
    sure = f"{verdict.sure}; the {len(names)} in doubt are left out"
    return replace(verdict, **figures, registered=good, photos=photos, sure=sure)


def work(arguments: Any, on_stage: OnStage) -> dict[str, float]:
    """Be the child: remove photos by name; returns the figures of the model that is left."""
    target, names = Path(arguments[0]), set(arguments[1])
    sparse = target / "sparse" / "0"
    with quiet_pycolmap(_TASK) as pycolmap:
        model = pycolmap.Reconstruction(sparse)
        for frame in {image.frame_id for image in model.images.values() if image.name in names}:
            model.deregister_frame(frame)
        model.write(sparse)
        for name in names:
            (target / "images" / name).unlink()
            (target / MASKS / f"{name}.png").unlink(missing_ok=True)
        return point_figures(model)
