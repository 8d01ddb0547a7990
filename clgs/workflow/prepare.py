"""Photos or a video to a data set, with the page about its poses: `clgs prepare`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from clgs.export.poses_page import write_poses_page
from clgs.opencl.device import Device
from clgs.poses.judging.verdict import Verdict
from clgs.poses.prepare import Doubts, prepare
from clgs.train.quality.pose_check import check_poses
from clgs.workflow.events import OnEvent, StageProgress, ignore

PAGE = "report.html"
"""The page about the poses, in the data set."""


def prepare_data(
    photos: Path | str,
    output: Path,
    *,
    seed: int = 0,
    quick: bool = False,
    frames: int | None = None,
    drop_doubtful: bool = False,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> Verdict:
    """Find poses and points, test them, and write the page about them to ``output``.

    :func:`clgs.prepare` describes the arguments, the errors and the other files.
    """
    verdict = prepare(
        photos,
        output,
        seed,
        lambda stage, done, total: on_event(StageProgress(stage, done, total)),
        overwrite=overwrite,
        quick=quick,
        frames=frames,
        doubts=Doubts(None if quick else short_training, drop_doubtful),
    )
    write_poses_page(output / PAGE, output, verdict)
    return verdict


def short_training(data: Path, on_step: Callable[[int, int], None]) -> dict[str, float]:
    """The share of each photo's variance that a short training leaves unexplained, by name."""
    return check_poses(data, Device(), on_step)
