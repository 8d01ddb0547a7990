"""A trained scene in a given number of bytes, or with a given PSNR, without training.

Anchors are dropped, least useful per bit first; before that, Q_O, Q_A or Q_S may be made coarser.
Q_P stays: a coarser grid would move all Gaussians of an anchor, and positions are a small share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.codec.fit_size import (
    Factors,
    anchor_bits,
    coarsen,
    fit_size,
    least_size,
    most_useful_first,
    take,
)
from clgs.data.view import View
from clgs.errors import UsageError
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.importance import importance_without_views, sensitivity
from clgs.train.quality.score_views import mean_psnr

Encode = Callable[[QuantizedScene], bytes]

COARSER = ("offset", "feature", "scaling")
"""Attributes whose Q may be multiplied by STEP, again and again, while that costs least."""

STEP = 0.75

SPARE = 1.1
"""A coarser Q is tried if all anchors would still take this many times the room."""

MAX_VIEWS = 48
"""The most views that say what is useful; each shows anchors that few others do."""

MEASURED, COMPARED = 12, 6
"""Views on which PSNR is measured, unless all are asked for, and on which Q are compared."""

PIXELS = 2.0
"""Usefulness is judged at half the resolution if this many pixels per anchor remain."""

ROUND = 0.15
"""Share of all anchors that is dropped before the others are judged again."""

PSNR_STEPS = 6


@dataclass(frozen=True)
class SceneJudge:
    """The views that say what is useful, and those that PSNR is measured on.

    on_render: called after each picture.
    """

    device: Device
    seen: Sequence[View]
    views: Sequence[View]
    options: RenderOptions = DEFAULT
    on_render: Callable[[], None] = lambda: None

    def psnr(self, scene: QuantizedScene, count: int | None = None) -> float:
        """Mean over the views, or ``count`` of them, in dB, as ``clgs eval`` measures it."""
        renderer = Renderer(self.device, scene.dequantize(), self.options)
        views = self.views[:: max(1, len(self.views) // count) if count else 1]
        return mean_psnr(renderer, views, scene.settings.background, self.on_render)

    def importance(self, scene: QuantizedScene) -> npt.NDArray[np.float64]:
        """The squared error of the pictures that each anchor saves, (A,)."""
        room = PIXELS * len(scene.anchors)
        factors = [
            2 if view.camera.width * view.camera.height >= 4 * room else 1 for view in self.seen
        ]
        pairs = list(zip(self.seen, factors, strict=True))
        cameras = [view.camera.reduced(factor) for view, factor in pairs]
        used = [view.used(factor) for view, factor in pairs]
        uploaded = upload_scene(self.device, scene.dequantize())
        shared = scene.settings, cameras, self.options, False, self.on_render, used
        found = sensitivity(self.device, uploaded, *shared)
        return found.importance.astype(np.float64)


@dataclass(frozen=True)
class Reduced:
    """The scene that was found, its file, what Q was multiplied by, and PSNR before and after.

    psnr: None if there were no views to measure by.
    """

    scene: QuantizedScene
    data: bytes
    factors: Factors
    psnr: tuple[float, float] | None


def reduce_to_size(
    scene: QuantizedScene, target: int, encode: Encode, judge: SceneJudge | None
) -> Reduced:
    """Reduce a scene to at most ``target`` bytes, at least 99 % of them if anchors suffice.

    Raises:
        UsageError: the file is larger even without anchors.
    """
    whole = len(data := encode(scene))
    before = judge.psnr(scene) if judge and whole <= target else None
    if whole <= target:
        return Reduced(scene, data, {}, (before, before) if before is not None else None)
    least = least_size(scene, target, encode)
    if judge is None:
        order = most_useful_first(scene, importance_without_views(scene))
        return Reduced(*fit_size(scene, order, target, encode, whole), {}, None)
    before = judge.psnr(scene)
    room = (target - least) / (whole - least) * float(anchor_bits(scene.anchors).sum())
    order, _ = rank(scene, judge, lambda cut: anchor_bits(cut.anchors).sum() < room)
    factors = _best_factors(scene, order, room, judge)
    found, data = fit_size(coarsen(scene, factors), order, target, encode, whole)
    return Reduced(found, data, factors, (before, judge.psnr(found)))


def reduce_to_psnr(
    scene: QuantizedScene, target: float, encode: Encode, judge: SceneJudge
) -> Reduced:
    """Keep the fewest anchors, most useful first, that have ``target`` dB on the views.

    Raises:
        UsageError: the whole scene is below ``target``, or one without anchors is not.
    """
    before, least = judge.psnr(scene), judge.psnr(take(scene, np.arange(0)))
    if before < target:
        raise UsageError(
            f"the whole scene has {before:.2f} dB on the training views, less than {target:g} dB; "
            "ask for less"
        )
    if least >= target:
        raise UsageError(
            f"{target:g} dB is too little: {least:.2f} dB remain without anchors; ask for more"
        )
    order, (low, high) = rank(scene, judge, lambda cut: judge.psnr(cut) < target)
    best, after, steps = take(scene, order[:high]), None, PSNR_STEPS
    while steps > 0 and high - low > 1:
        steps -= low > 0  # low is 0: no number is known to be too few yet
        count = (low + high) // 2
        trial = take(scene, order[:count])
        reached = judge.psnr(trial)
        if reached >= target:
            high, best, after = count, trial, reached
        else:
            low = count
    return Reduced(best, encode(best), {}, (before, judge.psnr(best) if after is None else after))


def rank(
    scene: QuantizedScene, judge: SceneJudge, too_few: Callable[[QuantizedScene], bool]
) -> tuple[npt.NDArray[np.intp], tuple[int, int]]:
    """Order the anchors (A,), most useful first; those left are judged again after every ROUND.

    Anchors gain importance as others go. Rounds end when ``too_few`` says that a cut goes too far.
    Also returned are two numbers of anchors, counted in this order: one that is too few (or 0), and
    one that is not.
    """
    rows, dropped = np.arange(len(scene.anchors)), np.empty(0, np.intp)
    while True:
        left = take(scene, rows)
        ranked = rows[most_useful_first(left, judge.importance(left))]
        count = min(int(np.ceil(len(ranked) - ROUND * len(scene.anchors))), len(ranked) - 1)
        if count <= 0 or too_few(take(scene, ranked[:count])):
            return np.concatenate([ranked, dropped]), (max(count, 0), len(ranked))
        rows, dropped = np.sort(ranked[:count]), np.concatenate([ranked[count:], dropped])


def _best_factors(
    scene: QuantizedScene, order: npt.NDArray[np.intp], room: float, judge: SceneJudge
) -> Factors:
    """Find what to multiply Q by for the best PSNR in about ``room`` bits of anchors.

    Anchors are kept from the start of ``order`` on. One attribute becomes one STEP coarser at a
    time, as long as that is a gain.
    """

    def reached(factors: Factors) -> float:
        coarse = coarsen(scene, factors)
        cost = np.cumsum(anchor_bits(coarse.anchors)[order])
        if factors and cost[-1] < SPARE * room:
            return -np.inf
        return judge.psnr(take(coarse, order[: int(np.searchsorted(cost, room))]), COMPARED)

    factors: Factors = {}
    best = reached(factors)
    while True:
        trials = [{**factors, name: factors.get(name, 1.0) * STEP} for name in COARSER]
        scores = [reached(trial) for trial in trials]
        if not max(scores) > best:
            return factors
        best, factors = max(scores), trials[int(np.argmax(scores))]


def spread(cameras: Sequence[Camera], count: int) -> list[int]:
    """Choose ``count`` of the cameras, or all, far from each other; their numbers, ascending.

    The first camera is chosen, then always the one whose centre is farthest from those chosen
    before (Gonzalez 1985); of equals the one with the smallest number.
    """
    centre = np.array([camera.centre for camera in cameras])
    distance = np.full(len(cameras), np.inf)
    chosen: list[int] = []
    for _ in range(min(count, len(cameras))):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(centre - centre[chosen[-1]], axis=1))
        distance[chosen] = -1.0
    return sorted(chosen)
