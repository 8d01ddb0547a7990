"""A trained scene in a given number of bytes, or with a given PSNR, without training.

Q_O, Q_A and Q_S become coarser, and anchors are dropped, least useful first. Q_P stays: a coarser
grid would move all Gaussians of an anchor, and positions are a small share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from clgs.codec.smaller import (
    Factors,
    anchor_bits,
    coarsen,
    contribution,
    fit_coarsened,
    hidden_products,
    least_size,
    take,
)
from clgs.data.masks import Mask
from clgs.data.view import View
from clgs.errors import UsageError
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.importance import feature_products, sensitivity
from clgs.train.quality.scores import mean_psnr

Encode = Callable[[QuantizedScene], bytes]

COARSER = ("feature", "scaling", "offset")
"""Attributes whose Q may become coarser, in the order in which that is tried."""

STEPS = (0.6, 0.8)
"""What their Q are multiplied by as long as that is a gain, roughly first."""

BLIND = {"feature": 0.25, "scaling": 0.33, "offset": 0.4}
"""Without views Q become this coarse before anchors are dropped."""

MAX_VIEWS = 48
"""The most views that say what is useful; each shows anchors that few others do."""

MEASURED, COMPARED = 12, 6
"""Views on which PSNR is measured, unless all are asked for, and on which Q are compared."""

ADDED = 12
"""Views that show how errors of features add up."""

PIXELS = 2.0
"""Usefulness is judged at half the resolution if this many pixels per anchor remain."""

MEASURED_SHARE = 0.75
"""The power of an anchor's importance in its usefulness; the rest is that of how much it shows.

Importance is that of one anchor among all others, and many go at once.
"""

ROUND = 0.15
"""Share of all anchors that is dropped before the others are judged again."""

PSNR_STEPS = 6

SIZE_STEPS, SMALLER = 6, 0.8
"""How often coarser integers are tried for a PSNR, and what share of the last bytes comes next."""


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
        cameras, used = _seen(self.seen, len(scene.anchors))
        uploaded = upload_scene(self.device, scene.dequantize())
        shared = scene.settings, cameras, self.options, False, self.on_render, used
        found = sensitivity(self.device, uploaded, *shared)
        return found.importance.astype(np.float64)

    def products(self, scene: QuantizedScene) -> npt.NDArray[np.float64]:
        """How errors of features add up in the pictures, (F, F)."""
        few = self.seen[:: -(-len(self.seen) // ADDED)]
        cameras, used = _seen(few, len(scene.anchors))
        uploaded = upload_scene(self.device, scene.dequantize())
        shared = scene.settings, cameras, self.options, self.on_render, used
        return feature_products(self.device, uploaded, *shared)


def _seen(views: Sequence[View], anchors: int) -> tuple[list[Camera], list[Mask | None]]:
    """The cameras and masks of ``views``, of half the resolution if enough pixels remain."""
    room = PIXELS * anchors
    factors = [2 if view.camera.width * view.camera.height >= 4 * room else 1 for view in views]
    pairs = list(zip(views, factors, strict=True))
    cameras = [view.camera.reduced(factor) for view, factor in pairs]
    return cameras, [view.used(factor) for view, factor in pairs]


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
        order = np.argsort(-contribution(scene), kind="stable")
        found = fit_coarsened(scene, BLIND, hidden_products(scene.mlps), order, target, encode)
        return Reduced(*found, None)
    before = judge.psnr(scene)
    room = (target - least) / (whole - least) * float(anchor_bits(scene.anchors).sum())
    order, _ = rank(scene, judge, lambda cut: anchor_bits(cut.anchors).sum() < room)
    products = judge.products(scene)
    factors = _best_factors(scene, products, order, room, judge, dict.fromkeys(COARSER, 1.0))
    fitted = fit_coarsened(scene, factors, products, order, target, encode)
    return Reduced(*fitted, (before, judge.psnr(fitted[0])))


def reduce_to_psnr(
    scene: QuantizedScene, target: float, encode: Encode, judge: SceneJudge
) -> Reduced:
    """Find the smallest file that has ``target`` dB on the views.

    First the fewest anchors, most useful first; then coarser integers of more of them.

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
    reached = judge.psnr(best) if after is None else after
    found = Reduced(best, encode(best), {}, (before, reached))
    return _coarser(scene, target, encode, judge, order, found, before)


def _coarser(
    scene: QuantizedScene,
    target: float,
    encode: Encode,
    judge: SceneJudge,
    order: npt.NDArray[np.intp],
    found: Reduced,
    before: float,
) -> Reduced:
    """What has ``target`` dB in fewer bytes than ``found``, by coarser integers, if anything has.

    Anchors are kept from the start of ``order`` on. ``before``: PSNR of the whole scene.
    """
    whole, least = len(encode(scene)), len(encode(take(scene, np.arange(0))))
    if len(found.data) <= least:
        return found
    bits, products = float(anchor_bits(scene.anchors).sum()), judge.products(scene)
    factors, too_small = dict.fromkeys(COARSER, 1.0), least
    for _ in range(SIZE_STEPS):
        middle = (too_small + len(found.data)) // 2
        size = max(int(SMALLER * len(found.data)), middle)
        if size == too_small:
            break
        room = (size - least) / (whole - least) * bits
        factors = _best_factors(scene, products, order, room, judge, factors)
        fitted = fit_coarsened(scene, factors, products, order, size, encode)
        reached = judge.psnr(fitted[0])
        if reached >= target:
            found = Reduced(*fitted, (before, reached))
        else:
            too_small = size
    return found


def rank(
    scene: QuantizedScene, judge: SceneJudge, too_few: Callable[[QuantizedScene], bool]
) -> tuple[npt.NDArray[np.intp], tuple[int, int]]:
    """Order the anchors (A,), most useful first; those left are judged again after every ROUND.

    Anchors gain importance as others go. Rounds end when ``too_few`` says that a cut goes too far.
    Also returned are two numbers of anchors, counted in this order: one that is too few (or 0), and
    one that is not.
    """
    shown = contribution(scene)
    rows, dropped = np.arange(len(scene.anchors)), np.empty(0, np.intp)
    while True:
        left = take(scene, rows)
        useful = judge.importance(left) ** MEASURED_SHARE * shown[rows] ** (1 - MEASURED_SHARE)
        ranked = rows[np.argsort(-useful, kind="stable")]
        count = min(int(np.ceil(len(ranked) - ROUND * len(scene.anchors))), len(ranked) - 1)
        if count <= 0 or too_few(take(scene, ranked[:count])):
            return np.concatenate([ranked, dropped]), (max(count, 0), len(ranked))
        rows, dropped = np.sort(ranked[:count]), np.concatenate([ranked[count:], dropped])


def _best_factors(
    scene: QuantizedScene,
    products: npt.NDArray[np.float64],
    order: npt.NDArray[np.intp],
    room: float,
    judge: SceneJudge,
    factors: Factors,
) -> Factors:
    """Find what to multiply Q by for the best PSNR in about ``room`` bits of anchors.

    Anchors are kept from the start of ``order`` on. From ``factors`` on, one attribute after the
    other becomes coarser, or finer again, as long as that is a gain.
    """

    def reached(factors: Factors) -> float:
        coarse = coarsen(scene, factors, products)
        cost = np.cumsum(anchor_bits(coarse.anchors)[order])
        return judge.psnr(take(coarse, order[: int(np.searchsorted(cost, room))]), COMPARED)

    best = reached(factors)
    for step, name in product(STEPS, COARSER):
        for change in (step, 1 / step):
            start = best
            while (tried := factors | {name: min(1.0, factors[name] * change)}) != factors:
                if not (score := reached(tried)) > best:
                    break
                best, factors = score, tried
            if best > start:
                break
    return factors


def spread(views: Sequence[View], count: int) -> list[View]:
    """Choose ``count`` of the views, or all, far from each other; their order stays.

    The first view is chosen, then always the one whose camera's centre is farthest from those
    chosen before (Gonzalez 1985); of equals the first.
    """
    centre = np.array([view.camera.centre for view in views])
    distance = np.full(len(views), np.inf)
    chosen: list[int] = []
    for _ in range(min(count, len(views))):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(centre - centre[chosen[-1]], axis=1))
        distance[chosen] = -1.0
    return [views[i] for i in sorted(chosen)]
