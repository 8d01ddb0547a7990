"""Structure from motion by pycolmap, in a process of its own."""

from __future__ import annotations

import errno
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

from clgs.data.find import MASKS
from clgs.data.masks import undistort_masks
from clgs.errors import DataError
from clgs.poses.child import OnStage, run_child, serve
from clgs.poses.features import extract
from clgs.poses.job import Job, OnProgress
from clgs.poses.judging.check import reconstruct_half
from clgs.poses.judging.conclusion import conclude
from clgs.poses.judging.verdict import Verdict, verdict_of
from clgs.poses.matching import match
from clgs.poses.models import build, look_again
from clgs.poses.pycolmap_lazy import quiet_pycolmap
from clgs.poses.shots import list_shots, name_files, number_files, number_masks

JPEG_QUALITY = 95

LEAST_ROOM = 1 << 20
"""Bytes; a failure with less room than that is blamed on the disk."""

COUNT_SECONDS = 0.5
"""From one count of the undistorted photos to the next."""

_TASK = "structure from motion"


def reconstruct(target: Path, seed: int, quick: bool, on_progress: OnProgress) -> Verdict:
    """Poses and points of the photos in ``target``/work/images: fills images/ and sparse/0/.

    Args:
        target: folder of the new data set.
        seed: of all random choices.
        quick: half the features, one mapper, no second reconstruction.
        on_progress: told of each stage after "read".

    Raises:
        DataError: no reconstruction, no pycolmap, or it crashed.
        OSError: it failed on a full disk.
    """
    arguments = [str(target), seed, quick]
    try:
        return verdict_of(run_child(__name__, _TASK, arguments, lambda told: on_progress(*told)))
    except DataError as error:
        if shutil.disk_usage(target).free < LEAST_ROOM:  # SQLite ends the process then
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target)) from error
        raise


def main() -> None:
    """The process that does the work."""
    serve(_work)


def _work(arguments: Any, on_stage: OnStage) -> dict[str, Any]:
    target, seed, quick = arguments
    clock = _Clock(on_stage)
    with quiet_pycolmap(_TASK) as pycolmap:
        verdict = _reconstruct(pycolmap, Path(target), seed, quick, clock.tell)
    return replace(verdict, seconds=clock.seconds()).plain()


class _Clock:
    """Passes progress on, and keeps when each stage began."""

    def __init__(self, on_stage: OnStage) -> None:
        self._on_stage = on_stage
        self._began: dict[str, float] = {}

    def tell(self, stage: str, done: int, total: int) -> None:
        self._began.setdefault(stage, time.perf_counter())
        self._on_stage([stage, done, total])

    def seconds(self) -> dict[str, float]:
        """From the begin of each stage to that of the next."""
        ends = [*list(self._began.values())[1:], time.perf_counter()]
        stages = zip(self._began.items(), ends, strict=True)
        return {stage: round(end - begin, 1) for (stage, begin), end in stages}


def _reconstruct(
    pycolmap: Any, target: Path, seed: int, quick: bool, on_progress: OnProgress
) -> Verdict:
    work = target / "work"
    shots = list_shots(work / "images")
    number_files(shots, work / "images", work / "numbered")
    masks = number_masks(shots, work / MASKS, work / "numbered_masks")
    names, cameras = [shot.file for shot in shots], [shot.camera for shot in shots]
    job = Job(pycolmap, work / "numbered", work, names, cameras, seed, on_progress, masks)
    pycolmap.set_random_seed(seed)
    extract(job, max(shot.size for shot in shots), quick)
    match(job)
    choice = look_again(job, build(job, quick))
    model = choice.kept.reconstruction
    second = None if quick else reconstruct_half(job, choice.kept, choice.evidence)
    verdict = conclude(choice, second, not quick, {shot.file: shot.name for shot in shots})
    if verdict.registered < 2:
        raise DataError(
            "no photo could be placed for certain; take more, overlapping photos of a textured, "
            "motionless scene"
        )
    name_files(shots, work / "numbered", work / "images")
    _undistort(job, model, {shot.file: shot.name for shot in shots}, target)
    return verdict


def _undistort(job: Job, model: Any, names: dict[str, str], target: Path) -> None:
    """Undistorted images and the model with pinhole cameras, in place in ``target``."""
    for image in model.images.values():
        image.name = names[image.name]
    work = job.folder
    (work / "model").mkdir()
    model.write(work / "model")
    made, total = work / "undistorted" / "images", model.num_reg_images()
    with _files_counted(made, lambda done: job.on_progress("undistort", done, total)):
        job.pycolmap.undistort_images(
            work / "undistorted", work / "model", work / "images", jpeg_quality=JPEG_QUALITY
        )
    made.rename(target / "images")
    undistort_masks(job.pycolmap, model, work / MASKS, target / "images", target / MASKS)
    (target / "sparse").mkdir()
    (work / "undistorted" / "sparse").rename(target / "sparse" / "0")


@contextmanager
def _files_counted(folder: Path, on_count: Callable[[int], None]) -> Iterator[None]:
    """Within the block ``on_count`` is told how many files ``folder`` holds; at last at its end.

    pycolmap does not tell how many photos it has undistorted.
    """
    ended = Event()

    def count() -> None:
        on_count(sum(len(names) for _, _, names in os.walk(folder)))

    def watch() -> None:
        while not ended.wait(COUNT_SECONDS):
            count()

    on_count(0)
    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
    count()
