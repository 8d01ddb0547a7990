"""Photos or a video to a data set, with the page about its poses: `clgs prepare`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

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
    photos: Path | str,
    output: Path,
    *,
    seed: int = 0,
    quick: bool = False,
    frames: int | None = None,
    drop_doubtful: bool = False,
    max_size: int = 0,
    device: str | None = None,
    equirectangular: bool = False,
    poses: Path | str | None = None,
    continued: Path | str | None = None,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> PreparedData:
    """Find poses and points, test them, and write the page about them to ``output``.

    :func:`clgs.prepare` describes the arguments, the errors and the other files.
    """
    start = time.perf_counter()
    verdict = prepare(
        photos,
        output,
        seed,
        lambda stage, done, total: on_event(StageProgress(stage, done, total)),
        overwrite=overwrite,
        quick=quick,
        frames=frames,
        drop_doubtful=drop_doubtful,
        max_size=max_size,
        device=device,
        equirectangular=equirectangular,
        poses=poses,
        continued=continued,
    )
    page = output / PAGE
    write_poses_page(page, output, verdict)
    return PreparedData(output, verdict, page, time.perf_counter() - start)
