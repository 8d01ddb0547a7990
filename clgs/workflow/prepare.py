"""Photos or a video to a data set, with the page about its poses: `clgs prepare`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clgs.exports.poses_page import write_poses_page
from clgs.poses.prepare import prepare
from clgs.poses.verdict import Verdict
from clgs.workflow.events import OnEvent, StageProgress, ignore

PAGE = "report.html"


@dataclass(frozen=True)
class PreparedData:
    """A data set that was made, the verdict on its poses, the page about it, and the seconds."""

    folder: Path
    verdict: Verdict
    page: Path
    seconds: float


def prepare_data(
    photos: Path | str, output: Path, *, on_event: OnEvent = ignore, **options: Any
) -> PreparedData:
    """Find poses and points, test them, and write the page about them to ``output``.

    :func:`clgs.prepare` describes the arguments, ``options`` included, the errors and the other
    files.
    """
    start = time.perf_counter()

    def follow(stage: str, done: int, total: int) -> None:
        on_event(StageProgress(stage, done, total))

    verdict = prepare(photos, output, on_progress=follow, **options)
    page = output / PAGE
    write_poses_page(page, output, verdict)
    return PreparedData(output, verdict, page, time.perf_counter() - start)
