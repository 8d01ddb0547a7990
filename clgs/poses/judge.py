"""The verdict on a reconstruction: every photo is good, doubtful or left out, for reasons.

:func:`judge` shows the whole way from the evidence to the verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clgs.poses.evidence import (
    MAX_CONTRADICTED,
    Explained,
    ModelChoice,
    PoseDifference,
    Poses,
    angle,
    differences,
    poses_of,
)
from clgs.poses.verdict import (
    DOUBTFUL,
    GOOD,
    LEFT_OUT,
    PhotoVerdict,
    Verdict,
    point_figures,
)

MAX_TURN, MAX_SHIFT = 0.5, 2.0
"""Degrees by which a second reconstruction may differ: half of what training forgives."""

FAR = 5.0
"""Degrees of turn beyond which one of two poses is useless."""

OTHER_SIDE = 30.0
"""Degrees of turn that no noise explains: the photo stands at another, similar place."""

FEW = 50
"""A pose on fewer points is doubtful; on fewer than twice as many it cannot outvote a doubt."""

LOW_RATIO, WRONG_RATIO = 0.5, 0.25
"""Shares of a photo's matches in links that agree with its pose: below the first it is doubtful,
below the second wrong."""

CLEAR_RATIO = 0.8
"""A photo of which a smaller share of matches agrees is placed again; nearly all have more."""

APART, APART_TIMES = 45.0, 5.0
"""A photo stands apart if it is turned by this many degrees from both neighbours by name, and by
this many times the median."""

MIN_EQUAL = 0.9
"""A rival model is heard if it explains this share of the matches that the kept one does."""

MAX_ELSEWHERE = 0.03
"""Above this share of photos at another side the scene is ambiguous."""

MAX_DROPPED = 1 / 3
"""If more of the photos had to be left out, the whole is in doubt, and none is left out."""

MOSTLY_GOOD = 0.8
"""Share of good photos from which poses are mostly sure."""

MORE = "take more photos between it and its neighbours, or remove it"
SHARPER = "replace it by a sharp photo that shares more of the scene with others, or remove it"
SIDES = "put something unsymmetrical into the scene and photograph it again, or remove the photo"
CONNECT = "take photos that connect both parts, or prepare each by itself"

Differences = Mapping[str, PoseDifference]
"""The differences from another reconstruction by name; without the photos that it does not place.
"""


def judge(choice: ModelChoice, second: Any | None, checked: bool, names: Sequence[str]) -> Verdict:
    """Judge every photo, and take photos with a wrong pose out of the kept model.

    ``second``: the second reconstruction, None if it failed or was not made; ``checked``: it was to
    be made; ``names``: of all photos, in order.
    """
    kept, model = choice.kept, choice.kept.reconstruction
    poses = poses_of(model)
    again: Differences | None = None
    if checked:
        again = differences(poses, poses_of(second)) if second is not None else {}
    rival = _differences_from_rival(choice, poses)
    judged = judge_photos(photo_figures(model, poses, kept.explained), again, rival)
    judged = leave_out_parts(judged, choice.apart, checked)
    ambiguous = is_ambiguous(again, rival, kept.explained, len(poses.names))

    wrong = [name for name, one in judged.items() if one.status == LEFT_OUT]
    images = [model.find_image_with_name(name) for name in wrong]
    between = kept.explained.without({image.image_id for image in images})
    if between.contradicted > MAX_CONTRADICTED:
        judged = doubt_all(judged, between.contradicted)
    for image in images:
        model.deregister_frame(image.frame_id)

    photos = tuple(
        judged[name] if name in judged else _without_pose(name, choice) for name in names
    )
    placed = {name for name, one in judged.items() if one.status != LEFT_OUT}
    apart = (tuple(one for one in part if one not in placed) for part in choice.apart)
    return Verdict(
        registered=model.num_reg_images(),
        total=len(names),
        **point_figures(model),
        mapper=kept.mapper,
        explained={one.mapper: one.explained.total for one in choice.candidates},
        apart=tuple(filter(None, apart)),
        photos=photos,
        checked=checked,
        ambiguous=ambiguous,
        contradicted=kept.explained.contradicted,
        sure=_sure(photos, checked, ambiguous),
    )


def unconfirmed(choice: ModelChoice, second: Any | None) -> list[str]:
    """List the photos of the kept model that should be placed again.

    The second reconstruction lacks them or places them elsewhere, or their own matches contradict
    their poses: both reconstructions may have made the same mistake.

    ``second``: None if it failed.
    """
    model = choice.kept.reconstruction
    poses, ratio = poses_of(model), choice.kept.explained.inlier_ratios()
    again = differences(poses, poses_of(second)) if second is not None else {}
    number = {name: model.find_image_with_name(name).image_id for name in poses.names}
    return [
        name
        for name in poses.names
        if _second_doubts(again.get(name)) or ratio.get(number[name], 0.0) < CLEAR_RATIO
    ]


def _differences_from_rival(choice: ModelChoice, poses: Poses) -> Differences:
    """Compare with the other mapper's model, if that explains about as many matches.

    Photos whose matches contradict the other model are left out: mappers lose a few now and then.
    """
    kept = choice.kept
    for one in choice.candidates:
        equal = one.explained.total >= MIN_EQUAL * kept.explained.total
        if one.mapper != kept.mapper and equal:
            model, ratio = one.reconstruction, one.explained.inlier_ratios()
            found = differences(poses, poses_of(model))
            number = {name: model.find_image_with_name(name).image_id for name in found}
            lost = {name for name in found if ratio.get(number[name], 0.0) < WRONG_RATIO}
            return {name: one for name, one in found.items() if name not in lost}
    return {}


def photo_figures(model: Any, poses: Poses, explained: Explained) -> dict[str, PhotoVerdict]:
    """Compute the figures of each photo with a pose in a pycolmap reconstruction, by name.

    Their status is GOOD.
    """
    ratio = explained.inlier_ratios()
    up = -poses.rotation[:, 1]
    # The direction with the least sum of angles to the others is nearly their median.
    between = np.degrees(np.arccos(np.clip(up @ up.T, -1.0, 1.0)))
    tilt = between[between.sum(1).argmin()]
    turned = np.einsum("nij,nkj->nik", poses.rotation[1:], poses.rotation[:-1])
    step = angle(turned).tolist()
    found = {}
    for place, name in enumerate(poses.names):
        image = model.find_image_with_name(name)
        seen = [(p.point3D_id, p.xy) for p in image.get_observation_points2D()]
        points = [model.point3D(number) for number, _ in seen]
        length = error = 0.0
        if points:
            length = float(np.mean([p.track.length() for p in points]))
            pose, world = image.cam_from_world(), np.array([p.xyz for p in points])
            local = world @ np.asarray(pose.rotation.matrix()).T + pose.translation
            projected = np.asarray(image.camera.img_from_cam(local, check_cheirality=False))
            off = np.linalg.norm(projected - np.array([xy for _, xy in seen]), axis=1)
            error = float(off.mean())
        found[name] = PhotoVerdict(
            name,
            GOOD,
            len(points),
            ratio.get(image.image_id, 0.0),
            length,
            error,
            float(tilt[place]),
            min(step[max(place - 1, 0) : place + 1], default=None),
        )
    return found


def judge_photos(
    figures: Mapping[str, PhotoVerdict], again: Differences | None, rival: Differences
) -> dict[str, PhotoVerdict]:
    """Judge every photo with a pose by itself, in the order of names.

    ``figures``: of :func:`photo_figures`; ``again``: differences from the second reconstruction,
    None if it was not to be made; ``rival``: from the other mapper's model.
    """
    steps = [one.step for one in figures.values() if one.step is not None]
    usual = float(np.median(steps)) if steps else 0.0
    ends = {*list(figures)[:1], *list(figures)[-1:]}
    judged = {}
    for name, one in figures.items():
        second = again.get(name) if again else None
        doubts = _own_doubts(one, 0.0 if name in ends else one.step or 0.0, usual)
        doubts += _second_doubts(second) if again is not None else []
        if name in rival and rival[name].turn > FAR:
            turn = rival[name].turn
            text = f"two mappers turn it {turn:.0f} degrees apart"
            doubts.append((text, SIDES if turn > OTHER_SIDE else MORE))
        # A pose that is clearly wrong goes: most matches contradict it, or it rests on little.
        ratio = one.inlier_ratio or 0.0
        weak = one.observations < 2 * FEW or ratio < LOW_RATIO
        far = second is not None and second.turn > FAR
        wrong = ratio < WRONG_RATIO or (far and weak)
        judged[name] = replace(
            one,
            status=LEFT_OUT if wrong else DOUBTFUL if doubts else GOOD,
            turn=second.turn if second else None,
            shift=second.shift if second else None,
            reasons=tuple(reason for reason, _ in doubts),
            remedy=doubts[0][1] if doubts else "",
        )
    if sum(one.status == LEFT_OUT for one in judged.values()) > MAX_DROPPED * len(judged):
        for name, verdict in judged.items():
            if verdict.status == LEFT_OUT:
                judged[name] = replace(verdict, status=DOUBTFUL)
    return judged


def _own_doubts(one: PhotoVerdict, step: float, usual: float) -> list[tuple[str, str]]:
    """List reasons and remedies from a photo's own figures; usual: the median step, degrees."""
    doubts = []
    ratio = one.inlier_ratio or 0.0
    if ratio < LOW_RATIO:
        doubts.append((f"only {100 * ratio:.0f} % of its matches agree with its pose", SHARPER))
    if one.observations < FEW:
        doubts.append((f"it sees only {one.observations} points", SHARPER))
    if step > max(APART, APART_TIMES * usual):
        doubts.append((f"it is turned by {step:.0f} degrees from its neighbours by name", MORE))
    return doubts


def _second_doubts(second: PoseDifference | None) -> list[tuple[str, str]]:
    """List the reason and remedy if the second reconstruction lacks the photo or moves it."""
    if second is None:
        return [("a second reconstruction from half of the points could not place it", MORE)]
    if second.turn <= MAX_TURN and second.shift <= MAX_SHIFT:
        return []
    moved = f"turns it by {second.turn:.1f} and shifts it by {second.shift:.1f} degrees"
    return [(f"a second reconstruction {moved}", SIDES if second.turn > OTHER_SIDE else MORE)]


def leave_out_parts(
    judged: Mapping[str, PhotoVerdict], parts: Sequence[Sequence[str]], checked: bool
) -> dict[str, PhotoVerdict]:
    """Leave out the parts that the second look joined, but the test did not confirm.

    A part hangs together by itself, so that a few loose matches turn all of it to a wrong side at
    once. If most of the other photos are good, it goes, unless a second reconstruction was made
    and most of its photos are good, too.

    ``parts`` are the names of the photos of each model that the strict matches made apart from the
    kept one. ``checked``: a second reconstruction was to be made; without it nothing confirms.
    """

    def mostly_good(names: Sequence[str]) -> bool:
        return 2 * sum(judged[name].status == GOOD for name in names) > len(names)

    found = dict(judged)
    for part in parts:
        joined = [name for name in part if name in judged]
        others = [name for name in judged if name not in joined]
        confirmed = checked and mostly_good(joined)
        if len(part) > 1 and not confirmed and mostly_good(others):
            for name in joined:
                reasons = (_part_reason(part), *judged[name].reasons)
                found[name] = replace(
                    judged[name], status=LEFT_OUT, reasons=reasons, remedy=CONNECT
                )
    return found


def _part_reason(part: Sequence[str]) -> str:
    others = len(part) - 1
    return f"it and {others} other{'s' * (others > 1)} form a part of their own"


def _without_pose(name: str, choice: ModelChoice) -> PhotoVerdict:
    part = next((names for names in choice.apart if name in names), [])
    if len(part) > 1:
        return PhotoVerdict(name, LEFT_OUT, reasons=(_part_reason(part),), remedy=CONNECT)
    reason = "it shares too little with the other photos"
    return PhotoVerdict(name, LEFT_OUT, reasons=(reason,), remedy=SHARPER)


def is_ambiguous(
    again: Differences | None, rival: Differences, explained: Explained, photos: int
) -> bool:
    """Whether the photos fit together in more than one way; arguments as of judge_photos."""
    elsewhere = {
        name for some in (again or {}, rival) for name, one in some.items() if one.turn > OTHER_SIDE
    }
    many = len(elsewhere) >= max(2.0, MAX_ELSEWHERE * photos)
    return many or explained.contradicted > MAX_CONTRADICTED


def doubt_all(judged: Mapping[str, PhotoVerdict], contradicted: float) -> dict[str, PhotoVerdict]:
    """Make all good photos doubtful, since this share of links' matches contradicts the poses.

    If photos of sides that look alike agree on one place, each agrees as well as if it were right.
    """
    reason = f"{100 * contradicted:.0f} % of the best matches of all photos contradict the poses"
    return {
        name: replace(one, status=DOUBTFUL, reasons=(reason,), remedy=SIDES)
        if one.status == GOOD
        else one
        for name, one in judged.items()
    }


def _sure(photos: Sequence[PhotoVerdict], checked: bool, ambiguous: bool) -> str:
    good, doubtful = (sum(one.status == status for one in photos) for status in (GOOD, DOUBTFUL))
    if ambiguous:
        return (
            "not sure: the scene looks alike from several sides, and photos fit together in more "
            f"than one way; {doubtful} are doubtful"
        )
    if not checked:
        return "not checked: without --quick, a second reconstruction tests every pose"
    if good == len(photos):
        worst = max((one.turn or 0.0 for one in photos), default=0.0)
        return (
            "sure: a second reconstruction from half of the points turns no photo by more than "
            f"{worst:.2f} degrees"
        )
    level = "mostly sure" if good >= MOSTLY_GOOD * len(photos) else "not sure"
    return (
        f"{level}: a second reconstruction confirms {good} of {len(photos)} photos; see the others"
    )
