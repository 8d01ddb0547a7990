"""Render a dataset's views from a scene and score them against the photos."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import View
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.renderer import Renderer
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.metrics import psnr_8bit, psnr_channel_mean, ssim, to_8bit
from clgs.train.step.targets import planar

PROTOCOL = "clgs-1: 8-bit, one MSE over all channels; SSIM 11x11 sigma 1.5, zero padding"


@dataclass(frozen=True)
class ViewScore:
    """One view: its name, the scores, the render and the photo as (H, W, 3) uint8."""

    name: str
    psnr: float
    psnr_channel_mean: float
    ssim: float
    seconds: float
    render: npt.NDArray[np.uint8]
    photo: npt.NDArray[np.uint8]

    def record(self) -> dict[str, Any]:
        """The scores, ready for JSON."""
        names = ("name", "psnr", "psnr_channel_mean", "ssim", "seconds")
        return {name: getattr(self, name) for name in names}


def evaluate_views(
    device: Device,
    scene: QuantizedScene,
    views: list[View],
    on_view: Callable[[ViewScore], None] | None = None,
    options: RenderOptions = DEFAULT,
) -> list[ViewScore]:
    """Score ``scene`` on ``views`` over the scene's own background.

    Raises:
        BudgetError: ``options.max_memory`` is too small for one of ``views``.
    """
    renderer = Renderer(device, scene.dequantize(), options)
    renderer.check_budget((view.name, view.camera) for view in views)
    scores = []
    for view in views:
        scores.append(_score(renderer, view, scene.settings.background))
        if on_view is not None:
            on_view(scores[-1])
    return scores


def _score(renderer: Renderer, view: View, background: tuple[float, float, float]) -> ViewScore:
    start = time.perf_counter()
    image = renderer.render(view.camera)
    seconds = time.perf_counter() - start
    photo = np.ascontiguousarray(planar(view, background).transpose(1, 2, 0))
    picture = to_8bit(image)
    return ViewScore(
        view.name,
        psnr_8bit(picture, photo),
        psnr_channel_mean(image, photo),
        ssim(picture, photo),
        seconds,
        picture,
        photo,
    )


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
