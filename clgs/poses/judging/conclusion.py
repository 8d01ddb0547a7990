"""From a chosen model to the verdict on the whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clgs.poses.judging.agreement import Difference, differences, poses_of
from clgs.poses.judging.figures import figures, inlier_ratios
from clgs.poses.judging.judge import (
    MIN_EQUAL,
    SHARPER,
    WRONG_RATIO,
    Comparison,
    doubt_all,
    is_ambiguous,
    judge,
)
from clgs.poses.judging.parts import CONNECT, leave_out_parts, part_reason
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict, Verdict
from clgs.poses.models import Choice


def conclude(choice: Choice, second: Any | None, checked: bool, real: Mapping[str, str]) -> Verdict:
    """Judge every photo and take those with a wrong pose out of the kept model.

    Args:
        choice: the model that is kept.
        second: the second reconstruction, None if it failed or was not made.
        checked: whether it was to be made.
        real: the photos' own names by those that the models use, all of them, in order.
    """
    kept, model = choice.kept, choice.kept.reconstruction
    poses = poses_of(model)
    found = figures(model, poses, kept.explained)
    again = differences(poses, poses_of(second)) if second is not None else {}
    compared = Comparison(again if checked else None, _rival(choice))
    judged = leave_out_parts(judge(found, compared), choice.apart, checked)
    ambiguous = is_ambiguous(compared, kept.explained, len(found))
    left_out = [
        model.find_image_with_name(n) for n, one in judged.items() if one.status == LEFT_OUT
    ]
    judged = doubt_all(judged, kept.explained.without({image.image_id for image in left_out}))
    for image in left_out:
        model.deregister_frame(image.frame_id)
    photos = tuple(_named(judged.get(name), name, choice, real) for name in real)
    return Verdict(
        registered=model.num_reg_images(),
        total=len(real),
        points=model.num_points3D(),
        observations=model.compute_num_observations(),
        error=float(model.compute_mean_reprojection_error()),
        track_length=float(model.compute_mean_track_length()),
        mapper=kept.mapper,
        explained={one.mapper: one.explained.total for one in choice.candidates},
        apart=_still_apart(choice, judged, real),
        photos=photos,
        checked=checked,
        ambiguous=ambiguous,
        contradicted=kept.explained.contradicted,
        sure=_sure(photos, checked, ambiguous),
    )


def _rival(choice: Choice) -> dict[str, Difference]:
    """Differences from the other mapper's model, if that explains about as much.

    Of the photos alone that it does not contradict itself: mappers lose a few, now and then.
    """
    kept = choice.kept
    for one in choice.candidates:
        equal = one.explained.total >= MIN_EQUAL * kept.explained.total
        if one.mapper != kept.mapper and equal:
            model, ratio = one.reconstruction, inlier_ratios(one.explained)
            found = differences(poses_of(kept.reconstruction), poses_of(model))
            number = {name: model.find_image_with_name(name).image_id for name in found}
            lost = {name for name in found if ratio.get(number[name], 0.0) < WRONG_RATIO}
            return {name: one for name, one in found.items() if name not in lost}
    return {}


def _named(
    verdict: PhotoVerdict | None, name: str, choice: Choice, real: Mapping[str, str]
) -> PhotoVerdict:
    """The verdict with the photo's own name; without a pose, one that says why."""
    if verdict is not None:
        return PhotoVerdict(**{**vars(verdict), "name": real[name]})
    group = next((names for names in choice.apart if name in names), [])
    if len(group) > 1:
        reason, remedy = part_reason(len(group) - 1), CONNECT
    else:
        reason, remedy = "it shares too little with the other photos", SHARPER
    return PhotoVerdict(real[name], LEFT_OUT, reasons=(reason,), remedy=remedy)


def _still_apart(
    choice: Choice, judged: Mapping[str, PhotoVerdict], real: Mapping[str, str]
) -> tuple[tuple[str, ...], ...]:
    """The photos' own names of each part that the second look did not join."""
    placed = {name for name, one in judged.items() if one.status != LEFT_OUT}
    left = (tuple(real[one] for one in part if one not in placed) for part in choice.apart)
    return tuple(filter(None, left))


def _sure(photos: tuple[PhotoVerdict, ...], checked: bool, ambiguous: bool) -> str:
    """How sure the poses are, in one sentence."""
    counts = {status: sum(one.status == status for one in photos) for status in _STATUSES}
    good, doubtful, total = counts[GOOD], counts[DOUBTFUL], len(photos)
    if ambiguous:
        return (
            "not sure: the scene looks alike from several sides, and photos fit together in more "
            f"than one way; {doubtful} are doubtful"
        )
    if not checked:
        return (
            "not checked: without --quick, a second reconstruction and a short training test every "
            "pose"
        )
    if good == total:
        worst = max((one.turn or 0.0 for one in photos), default=0.0)
        return (
            "sure: a second reconstruction from half of the points turns no photo by more than "
            f"{worst:.2f} degrees"
        )
    level = "mostly sure" if good >= 0.8 * total else "not sure"
    return f"{level}: a second reconstruction confirms {good} of {total} photos; see the others"


_STATUSES = (GOOD, DOUBTFUL, LEFT_OUT)
