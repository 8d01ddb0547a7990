"""Render a dataset's views from a scene and score them against the photos."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.stored_photo import Planes
from clgs.data.view import View, with_photos
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.renderer import Renderer
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.metrics import psnr_8bit, psnr_channel_mean, ssim, to_8bit

PROTOCOL = "clgs-1: 8-bit, one MSE over all channels; SSIM 11x11 sigma 1.5, zero padding"


@dataclass(frozen=True)
class ViewScore:
    """One view: its name and the scores."""

    name: str
    psnr: float
    psnr_channel_mean: float
    ssim: float
    seconds: float

    def record(self) -> dict[str, Any]:
        """The scores, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Pictures:
    """What was compared: render and photo, (H, W, 3) uint8."""

    render: npt.NDArray[np.uint8]
    photo: npt.NDArray[np.uint8]


def evaluate_views(
    device: Device,
    scene: QuantizedScene,
    views: list[View],
    on_view: Callable[[ViewScore, Pictures], None] | None = None,
    options: RenderOptions = DEFAULT,
) -> list[ViewScore]:
    """Score ``scene`` on ``views`` over the scene's own background.

    Args:
        device: where to render.
        scene: what to score.
        views: with their photos, of which no more than two are in memory at a time.
        on_view: called after each view; nothing else keeps its pictures.
        options: of the renders.

    Raises:
        DataError: a photo is damaged.
        BudgetError: ``options.max_memory`` is too small for one of ``views``.
    """
    renderer = Renderer(device, scene.dequantize(), options)
    renderer.check_budget((view.name, view.camera) for view in views)
    scores = []
    for view, planes in with_photos(views, scene.settings.background):
        score, pictures = _score(renderer, view, planes)
        scores.append(score)
        if on_view is not None:
            on_view(score, pictures)
    return scores


def _score(renderer: Renderer, view: View, planes: Planes) -> tuple[ViewScore, Pictures]:
    start = time.perf_counter()
    image = renderer.render(view.camera)
    seconds = time.perf_counter() - start
    photo = np.ascontiguousarray(planes.transpose(1, 2, 0))
    picture = to_8bit(image)
    score = ViewScore(
        view.name,
        psnr_8bit(picture, photo),
        psnr_channel_mean(image, photo),
        ssim(picture, photo),
        seconds,
    )
    return score, Pictures(picture, photo)


def summarize(scene: QuantizedScene, scores: list[ViewScore], nbytes: int | None) -> dict[str, Any]:
    """Means over views with what a reader needs to compare them, ready for JSON."""

    def mean(name: str) -> float:
        return float(np.mean([getattr(score, name) for score in scores]))

    return {
        "protocol": PROTOCOL,
        "views": len(scores),
        "psnr": mean("psnr"),
        "psnr_channel_mean": mean("psnr_channel_mean"),
        "ssim": mean("ssim"),
        "bytes": nbytes,
        "anchors": len(scene.anchors),
        "render_seconds": mean("seconds"),
        "background": list(scene.settings.background),
    }
