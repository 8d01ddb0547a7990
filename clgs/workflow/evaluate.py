"""Scores of a scene against the photos of its data set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clgs.opencl.device import Device
from clgs.scene.scene import QuantizedScene, SplatScene
from clgs.train.quality.scores import (
    Measure,
    ViewScore,
    count_drawn,
    evaluate_views,
    summarize,
)
from clgs.workflow.events import OnEvent, counter, ignore
from clgs.workflow.options import ViewOptions
from clgs.workflow.views import drawing_options, over_background, select_views


@dataclass(frozen=True)
class Evaluation:
    """The means over the views with what they depend on, and the scores of each view."""

    summary: dict[str, Any]
    scores: list[ViewScore]

    def record(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return self.summary | {"per_view": [score.record() for score in self.scores]}


def evaluate(
    device: Device,
    path: Path,
    scene: QuantizedScene | SplatScene,
    size: int | None,
    views: ViewOptions,
    *,
    lpips: Measure | None = None,
    count_gaussians: bool = False,
    on_event: OnEvent = ignore,
) -> Evaluation:
    """Score ``scene``, which was read at ``path``, on the views of its data set.

    ``size``: bytes of its file, None if it has none. LPIPS is measured if it is given, and the
    Gaussians that are drawn are counted if ``count_gaussians`` says so.

    Raises:
        UsageError: no data set is named, neither by ``views`` nor by the run.
        DataError: the data set is damaged, empty, or that of another scene.
        BudgetError: ``views.max_memory`` is too small.
    """
    scene = over_background(scene, views.background)
    options = drawing_options(path, views, scene)
    chosen = select_views(path, scene, views, on_event)
    advance = counter("evaluating", len(chosen), on_event)
    scores = evaluate_views(device, scene, chosen, advance, options, lpips)
    summary = summarize(scene, scores, size)
    if count_gaussians and not isinstance(scene, SplatScene):
        advance = counter("counting Gaussians", len(chosen), on_event)
        cameras = [view.camera for view in chosen]
        summary["gaussians"] = count_drawn(device, scene, cameras, options, advance)
    summary |= {
        "accuracy": options.accuracy.name,
        "split": views.split or "test",
        "device": device.name,
    }
    return Evaluation(summary, scores)
