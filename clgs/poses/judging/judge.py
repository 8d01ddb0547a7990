"""The verdict on every photo: good, doubtful or to be left out, with reasons and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from clgs.poses.judging.agreement import Difference
from clgs.poses.judging.evidence import MAX_CONTRADICTED, Explained
from clgs.poses.judging.figures import Figures
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict

MAX_TURN, MAX_SHIFT = 0.5, 2.0
"""Degrees by which a second reconstruction may differ: half of what training forgives."""

FAR = 5.0
"""Degrees of turn beyond which one of two poses is useless."""

OTHER_SIDE = 30.0
"""Degrees of turn that no noise explains: the photo stands at another, similar place."""

FEW = 50
"""Points below which a pose is doubtful; and below twice as many it cannot outvote a doubt."""

LOW_RATIO, WRONG_RATIO = 0.5, 0.25
"""Shares of a photo's matches in links that agree with its pose: below the first it is doubtful,
below the second wrong."""

APART, APART_TIMES = 45.0, 5.0
"""Degrees from both neighbours by name, and times the median, from which a photo stands apart."""

MIN_EQUAL = 0.9
"""A rival model is heard if it explains this share of the matches that the kept one does."""

MAX_ELSEWHERE = 0.03
"""Above this share of photos at another side the scene is ambiguous."""

MAX_DROPPED = 1 / 3
"""Of the photos; if more had to go, the whole is in doubt, and none is dropped."""

MORE = "take more photos between it and its neighbours, or remove it"
SHARPER = "replace it by a sharp photo that shares more of the scene with others, or remove it"
SIDES = "put something unsymmetrical into the scene and photograph it again, or remove the photo"


@dataclass(frozen=True)
class Comparison:
    """With the second reconstruction (None: not made), and with the rival mapper's model.

    Both by name; photos that the other does not place are missing there.
    """

    second: Mapping[str, Difference] | None
    rival: Mapping[str, Difference]


def judge(found: Mapping[str, Figures], compared: Comparison) -> dict[str, PhotoVerdict]:
    """Verdicts on the photos that have a pose, by name, in the order of names."""
    steps = [min(one.steps) for one in found.values() if one.steps]
    usual = float(np.median(steps)) if steps else 0.0
    verdicts = {name: _judge(name, one, compared, usual) for name, one in found.items()}
    dropped = sum(one.status == LEFT_OUT for one in verdicts.values())
    if dropped > MAX_DROPPED * len(verdicts):
        return {name: _kept(one) for name, one in verdicts.items()}
    return verdicts


def is_ambiguous(compared: Comparison, explained: Explained, photos: int) -> bool:
    """Whether the photos fit together in more than one way."""
    elsewhere = {
        name
        for some in (compared.second or {}, compared.rival)
        for name, one in some.items()
        if one.turn > OTHER_SIDE
    }
    many = len(elsewhere) >= max(2.0, MAX_ELSEWHERE * photos)
    return many or explained.contradicted > MAX_CONTRADICTED


def doubt_all(judged: Mapping[str, PhotoVerdict], explained: Explained) -> dict[str, PhotoVerdict]:
    """None is good if too many of the links between photos that stay contradict the poses.

    Photos of sides that look alike then agree on one place, each as well as if it were right.
    """
    contradicted = explained.contradicted
    if contradicted <= MAX_CONTRADICTED:
        return dict(judged)
    reason = f"{100 * contradicted:.0f} % of the best matches of all photos contradict the poses"

    def doubted(one: PhotoVerdict) -> PhotoVerdict:
        return replace(one, status=DOUBTFUL, reasons=(reason,), remedy=SIDES)

    return {n: doubted(one) if one.status == GOOD else one for n, one in judged.items()}


def _kept(verdict: PhotoVerdict) -> PhotoVerdict:
    status = DOUBTFUL if verdict.status == LEFT_OUT else verdict.status
    return PhotoVerdict(**{**vars(verdict), "status": status})


def _judge(name: str, one: Figures, compared: Comparison, usual: float) -> PhotoVerdict:
    second = None if compared.second is None else compared.second.get(name)
    doubts = [
        *_support_doubts(one),
        *_neighbour_doubts(one, usual),
        *_second_doubts(second, compared),
        *_rival_doubts(compared.rival.get(name)),
    ]
    return PhotoVerdict(
        name,
        _status(one, second, bool(doubts)),
        one.observations,
        one.inlier_ratio,
        one.track_length,
        one.error,
        one.tilt,
        min(one.steps) if one.steps else None,
        second.turn if second else None,
        second.shift if second else None,
        tuple(reason for reason, _ in doubts),
        doubts[0][1] if doubts else "",
    )


def _status(one: Figures, second: Difference | None, doubted: bool) -> str:
    """A pose that is clearly wrong goes: most matches say so, or it has little to say against."""
    weak = one.observations < 2 * FEW or one.inlier_ratio < LOW_RATIO
    far = second is not None and second.turn > FAR
    if one.inlier_ratio < WRONG_RATIO or (far and weak):
        return LEFT_OUT
    return DOUBTFUL if doubted else GOOD


def _support_doubts(one: Figures) -> list[tuple[str, str]]:
    doubts = []
    if one.inlier_ratio < LOW_RATIO:
        share = f"only {100 * one.inlier_ratio:.0f} % of its matches agree with its pose"
        doubts.append((share, SHARPER))
    if one.observations < FEW:
        doubts.append((f"it sees only {one.observations} points", SHARPER))
    return doubts


def _neighbour_doubts(one: Figures, usual: float) -> list[tuple[str, str]]:
    """Of a photo that is turned far from the one before and the one after, as others are not."""
    if len(one.steps) < 2 or min(one.steps) <= max(APART, APART_TIMES * usual):
        return []
    text = f"it is turned by {min(one.steps):.0f} degrees from its neighbours by name"
    return [(text, MORE)]


def _second_doubts(second: Difference | None, compared: Comparison) -> list[tuple[str, str]]:
    if compared.second is None:
        return []
    if second is None:
        return [("a second reconstruction from half of the points could not place it", MORE)]
    if second.turn <= MAX_TURN and second.shift <= MAX_SHIFT:
        return []
    moved = f"turns it by {second.turn:.1f} and shifts it by {second.shift:.1f} degrees"
    remedy = SIDES if second.turn > OTHER_SIDE else MORE
    return [(f"a second reconstruction {moved}", remedy)]


def _rival_doubts(rival: Difference | None) -> list[tuple[str, str]]:
    if rival is None or rival.turn <= FAR:
        return []
    text = f"the incremental and the global mapper turn it {rival.turn:.0f} degrees apart"
    return [(text, SIDES if rival.turn > OTHER_SIDE else MORE)]
