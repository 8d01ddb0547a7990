"""Scores of a scene: its renders against photos, and how many Gaussians it has."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_type
from clgs.constants import K_OFFSETS
from clgs.data.stored_photo import Color
from clgs.data.view import View, with_photos
from clgs.opencl.device import Device
from clgs.ops import cull, mlp, neural
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene, upload_view
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene, SplatScene, drawable
from clgs.train.quality.metrics import blackened, psnr_8bit, psnr_channel_mean, ssim, to_8bit

PROTOCOL = (
    "clgs-1: 8-bit pictures; psnr: one MSE over all pixels and channels; psnr_channel_mean: mean "
    "of the three channels' PSNRs, of the render before clamping and rounding; ssim: 11x11, "
    "sigma 1.5, zero padding"
)
LPIPS_PROTOCOL = "; lpips: VGG, version 0.1, pictures in [0, 1] not rescaled to [-1, 1]"

Picture = npt.NDArray[np.uint8]

Measure = Callable[[Picture, Picture], float]
"""A score of a render and a photo, both (H, W, 3) uint8."""


@dataclass(frozen=True)
class ViewScore:
    """One view: its name and the scores; lpips is None if it was not measured."""

    name: str
    psnr: float
    psnr_channel_mean: float
    ssim: float
    seconds: float
    lpips: float | None = None

    def record(self) -> dict[str, Any]:
        """The scores, ready for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def evaluate_views(
    device: Device,
    scene: QuantizedScene | SplatScene,
    views: list[View],
    on_view: Callable[[str, Picture, Picture], None] = lambda name, render, photo: None,
    options: RenderOptions = DEFAULT,
    lpips: Measure | None = None,
) -> list[ViewScore]:
    """Score ``scene`` on ``views`` over the scene's own background.

    Args:
        device: where to render.
        scene: what to score.
        views: with their photos, of which no more than two are in memory at a time.
        on_view: called after each view with its name, render and photo, (H, W, 3) uint8, black
            where the photo is masked.
        options: of the renders.
        lpips: measured too if it is given, such as a :class:`clgs.train.quality.lpips.Lpips`.

    Raises:
        DataError: a photo is damaged.
        BudgetError: ``options.max_memory`` is too small for one of ``views``.
        TypeError: ``scene`` is neither a quantised scene nor one of splats, or ``views`` are no
            sequence of views.
    """
    if not isinstance(scene, SplatScene):
        remedy = "a run has it as .scene, clgs.load_scene reads one"
        check_type("scene", scene, QuantizedScene, remedy)
    check_type("views", views, Sequence, "such as [view], or .train and .test of a data set")
    for view in views:
        check_type("views", view, View, "a data set has them as .train and .test")
    renderer = Renderer(device, drawable(scene), options)
    renderer.check_budget((view.name, view.camera) for view in views)
    scores = []
    for view, planes in with_photos(views, scene.settings.background):
        start = time.perf_counter()
        image = renderer.render(view.camera)
        seconds = time.perf_counter() - start
        photo, used = np.ascontiguousarray(planes.transpose(1, 2, 0)), view.used()
        shown = blackened(to_8bit(image), used), blackened(photo, used)
        score = ViewScore(
            view.name,
            psnr_8bit(*shown, used),
            psnr_channel_mean(image, photo, used),
            ssim(*shown, used),
            seconds,
            lpips(*shown) if lpips else None,
        )
        scores.append(score)
        on_view(view.name, *shown)
    return scores


def mean_psnr(
    renderer: Renderer,
    views: Sequence[View],
    color: Color,
    on_view: Callable[[], None] = lambda: None,
) -> float:
    """Mean 8-bit PSNR of renders of ``views`` over the background ``color``.

    Raises:
        DataError: a photo is damaged.
        BudgetError: the renderer's budget is too small for one of ``views``.
    """
    renderer.check_budget((view.name, view.camera) for view in views)
    found = []
    for view, planes in with_photos(views, color):
        photo = np.ascontiguousarray(planes.transpose(1, 2, 0))
        found.append(psnr_8bit(to_8bit(renderer.render(view.camera)), photo, view.used()))
        on_view()
    return float(np.mean(found))


def summarize(
    scene: QuantizedScene | SplatScene, scores: list[ViewScore], nbytes: int | None
) -> dict[str, Any]:
    """Means over views with what a reader needs to compare them, ready for JSON."""

    def mean(name: str) -> float:
        return float(np.mean([getattr(score, name) for score in scores]))

    with_lpips = all(score.lpips is not None for score in scores)
    return {
        "protocol": PROTOCOL + LPIPS_PROTOCOL * with_lpips,
        "views": len(scores),
        "psnr": mean("psnr"),
        "psnr_channel_mean": mean("psnr_channel_mean"),
        "ssim": mean("ssim"),
        **({"lpips": mean("lpips")} if with_lpips else {}),
        "bytes": nbytes,
        **(
            {"gaussians": len(scene.gaussians)}
            if isinstance(scene, SplatScene)
            else {"anchors": len(scene.anchors)}
        ),
        "render_seconds": mean("seconds"),
        "background": list(scene.settings.background),
    }


def count_drawn(
    device: Device,
    scene: QuantizedScene,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_camera: Callable[[], None] = lambda: None,
) -> int:
    """Slots of anchors that at least one of ``cameras`` sees with a positive opacity.

    An anchor has K slots, and the opacity of each depends on the direction of view: a slot that no
    camera ever sees with an opacity above 0 is no Gaussian. ``on_camera`` is called after each.
    """
    uploaded = upload_scene(device, scene.dequantize())
    drawn = np.zeros(len(scene.anchors), np.int32)
    for camera in cameras:
        reduced = camera.reduced(options.accuracy.downscale)
        view = upload_view(device, reduced, scene.settings)
        visible = cull.forward(device, uploaded.anchors, view.camera, options)
        inputs = mlp.Inputs(uploaded.anchors, uploaded.weights, view.camera)
        activations = mlp.opacities(device, inputs, visible.anchor, options, K_OFFSETS)
        slots, _ = neural.number(device, activations)
        anchor = device.download(activations.visible)
        seen = anchor >= 0
        drawn[anchor[seen]] |= device.download(slots)[seen]
        on_camera()
    return int((drawn[:, None] >> np.arange(K_OFFSETS) & 1).sum())
