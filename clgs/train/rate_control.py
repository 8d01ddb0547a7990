"""A trained scene in a given number of bytes, or with a given PSNR, without training.

Anchors are dropped, least useful for each bit first; Q_O, Q_A or Q_S may be made coarser before it.
Q_P stays: a coarser grid would move all Gaussians of an anchor, and positions are a small share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.codec.fit_size import Factors, anchor_bits, coarsen, fit_size, most_useful_first, take
from clgs.data.dataset import View
from clgs.errors import UsageError
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.scene.scene import QuantizedScene
from clgs.train.evaluation import evaluate_views
from clgs.train.importance import importance, importance_without_views

Encode = Callable[[QuantizedScene], bytes]

MIXES: tuple[Factors, ...] = (
    {},
    {"scaling": 0.75},
    {"feature": 0.75},
    {"offset": 0.5},
)
"""What is tried before anchors are dropped."""

MAX_VIEWS = 48
"""Views that are looked at, evenly spread; to compare mixes, every COMPARED-th of them."""

COMPARED = 6

ROUND = 0.15
"""Share of all anchors that is dropped before the others are judged again."""

PSNR_STEPS = 9


@dataclass(frozen=True)
class Judge:
    """Training views to measure by."""

    device: Device
    views: list[View]
    options: RenderOptions = DEFAULT

    @classmethod
    def of(cls, device: Device, views: list[View], options: RenderOptions = DEFAULT) -> Judge:
        """One with at most MAX_VIEWS of ``views``."""
        count = min(len(views), MAX_VIEWS)
        chosen = [views[i * len(views) // count] for i in range(count)]
        return cls(device, chosen, options)

    def psnr(self, scene: QuantizedScene, every: int = 1) -> float:
        """Mean over the views, or every ``every``-th, in dB."""
        views = self.views[::every]
        scores = evaluate_views(self.device, scene, views, options=self.options)
        return float(np.mean([score.psnr for score in scores]))

    def importance(self, scene: QuantizedScene) -> npt.NDArray[np.float64]:
        """Of each anchor, (A,)."""
        return importance(self.device, scene, self.views, self.options)


@dataclass(frozen=True)
class Reduced:
    """The scene that was found, its file, what Q was multiplied by, and PSNR before and after.

    psnr: None where there were no views to measure by.
    """

    scene: QuantizedScene
    data: bytes
    factors: Factors
    psnr: tuple[float, float] | None


def reduce_to_size(
    scene: QuantizedScene, target: int, encode: Encode, judge: Judge | None
) -> Reduced:
    """At most ``target`` bytes, at least 99 % of them where anchors suffice.

    Raises:
        UsageError: the file is larger even without anchors.
    """
    whole = encode(scene)
    if len(whole) <= target:
        before = judge.psnr(scene) if judge else None
        return Reduced(scene, whole, {}, (before, before) if before is not None else None)
    useful = judge.importance(scene) if judge else importance_without_views(scene)
    factors: Factors = {}
    share = target / len(whole)
    if judge:
        factors = _best_mix(scene, useful, share, judge)
    coarse = coarsen(scene, factors)
    order = most_useful_first(coarse, useful)
    if judge:
        room = share * float(anchor_bits(scene.anchors).sum())
        order = rank(coarse, judge, lambda cut: anchor_bits(cut.anchors).sum() < room)
    found, data = fit_size(coarse, order, target, encode, len(whole))
    psnr = (judge.psnr(scene), judge.psnr(found)) if judge else None
    return Reduced(found, data, factors, psnr)


def reduce_to_psnr(scene: QuantizedScene, target: float, encode: Encode, judge: Judge) -> Reduced:
    """The fewest anchors, most useful first, that keep ``target`` dB on the views.

    Raises:
        UsageError: the whole scene is below ``target``.
    """
    before = after = judge.psnr(scene)
    if before < target:
        raise UsageError(
            f"the whole scene has {before:.2f} dB on the training views, less than {target:g} dB; "
            "ask for less"
        )
    order = rank(scene, judge, lambda cut: judge.psnr(cut) < target)
    low, high, best = 0, len(order), scene
    for _ in range(PSNR_STEPS):
        count = (low + high) // 2
        trial = take(scene, order[:count])
        reached = judge.psnr(trial)
        if reached >= target:
            high, best, after = count, trial, reached
        else:
            low = count
    return Reduced(best, encode(best), {}, (before, after))


def rank(
    scene: QuantizedScene, judge: Judge, too_few: Callable[[QuantizedScene], bool]
) -> npt.NDArray[np.intp]:
    """The anchors (A,), most useful first; what is left is judged again after every ROUND.

    Anchors gain importance as others go. Rounds end where ``too_few`` says that a cut goes too far.
    """
    rows, dropped = np.arange(len(scene.anchors)), np.empty(0, np.intp)
    while True:
        left = take(scene, rows)
        ranked = rows[most_useful_first(left, judge.importance(left))]
        count = min(int(np.ceil(len(ranked) - ROUND * len(scene.anchors))), len(ranked) - 1)
        if count <= 0 or too_few(take(scene, ranked[:count])):
            return np.concatenate([ranked, dropped])
        rows, dropped = np.sort(ranked[:count]), np.concatenate([ranked[count:], dropped])


def _best_mix(
    scene: QuantizedScene, useful: npt.NDArray[np.float64], share: float, judge: Judge
) -> Factors:
    """The mix with the best PSNR at about ``share`` of the bits of the whole scene."""
    room = share * float(anchor_bits(scene.anchors).sum())
    best: tuple[float, Factors] = (-np.inf, {})
    for factors in MIXES:
        coarse = coarsen(scene, factors)
        order = most_useful_first(coarse, useful)
        cost = np.cumsum(anchor_bits(coarse.anchors)[order])
        kept = take(coarse, order[: int(np.searchsorted(cost, room))])
        reached = judge.psnr(kept, COMPARED)
        if reached > best[0]:
            best = reached, factors
    return best[1]
