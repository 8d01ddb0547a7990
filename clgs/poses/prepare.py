"""Raw photos or a video to a COLMAP data set: structure from motion by pycolmap."""

from __future__ import annotations

import json
import logging
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from clgs.errors import ClgsError, DataError, ExistsError, OutputError
from clgs.files import atomic_folder, check_folder, is_full
from clgs.poses.contact_sheet import contact_sheet
from clgs.poses.drop import drop_doubtful
from clgs.poses.guard import removed_if_killed
from clgs.poses.job import OnProgress
from clgs.poses.judging.training import untrained, with_training
from clgs.poses.judging.verdict import Verdict
from clgs.poses.leftovers import owned, remove_leftovers
from clgs.poses.mapper import reconstruct
from clgs.poses.photos.bring_in import Source, bring_in, find_source
from clgs.poses.pycolmap_lazy import SEEDS

REPORT = "report.json"
"""The verdict, in the new data set."""

CONTACT_SHEET = "contact_sheet.jpg"
"""All photos of the verdict, in its order; see clgs.poses.contact_sheet."""

MADE = {"images", "masks", "sparse", REPORT, CONTACT_SHEET, "report.html"}
"""What an earlier call, or the command of that name, left in the folder that is replaced."""

ShortTraining = Callable[[Path, Callable[[int, int], None]], Mapping[str, float]]
"""Of the data set in a folder, told of its progress: see clgs.train.quality.pose_check."""


@dataclass(frozen=True)
class Doubts:
    """What else tests poses, and what becomes of photos that are in doubt.

    training: a short one, which tests whether every photo can be shown; None: none is made;
    drop: whether photos in doubt are left out.
    """

    training: ShortTraining | None = None
    drop: bool = False


_log = logging.getLogger(__name__)


def prepare(
    photos: Path | str,
    output: Path | str,
    seed: int = 0,
    on_progress: OnProgress = lambda stage, done, total: None,
    overwrite: bool = False,
    quick: bool = False,
    frames: int | None = None,
    doubts: Doubts = Doubts(),
) -> Verdict:
    """Poses and points of the photos in and below ``photos``, or of a video, in ``output``.

    ``output`` gets images/ (undistorted), masks/ if photos are masked, sparse/0/ (binary, pinhole
    cameras), report.json with the verdict that is returned, and contact_sheet.jpg; it appears
    complete or not at all. A warning names the files that are skipped.

    Args:
        photos: the folder, or a video.
        output: new folder, or an empty one.
        seed: of all random choices; the same seed gives the same poses.
        on_progress: called with a stage of ``clgs.poses.job.STAGES``, what of it is done, and of
            how much.
        overwrite: ``output`` may replace what an earlier call made.
        quick: half the features, one mapper, and no second reconstruction that tests the poses.
        frames: taken of a video; default 100.
        doubts: what else tests the poses, and what becomes of photos that are in doubt.

    Raises:
        DataError: too few or damaged photos, no reconstruction, no pycolmap; too few would be
            left without those in doubt.
        OutputError: ``output`` is not empty, or cannot be made.
        OSError: the disk is full, or another fault of ``output``.
    """
    source, output = find_source(Path(photos), frames), Path(output)
    try:
        check_folder(output.parent)
        output.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(output)
        if overwrite:
            _check_replaceable(output, source.files)
        with atomic_folder(output, overwrite) as target:
            with owned(target / "work"), removed_if_killed(target):
                verdict = _prepare(source, target, seed, quick, on_progress)
                verdict = _trained(verdict, target, doubts.training, on_progress)
                if doubts.drop:
                    verdict = drop_doubtful(target, verdict)
                _write_report(verdict, target)
            shutil.rmtree(target / "work")
            return verdict
    except OutputError:
        raise
    except OSError as error:
        if is_full(error):  # a copy names the photo, which has no fault
            raise OSError(error.errno, error.strerror, str(output)) from error
        problem = error.strerror or str(error)
        raise DataError(f"{error.filename or output}: {problem}") from error


def _check_replaceable(output: Path, source: list[Path]) -> None:
    """Raise OutputError unless ``output`` is free, or an earlier result without these photos."""
    if not output.is_dir() or not any(output.iterdir()):
        return
    if not (output / "sparse" / "0" / "cameras.bin").is_file():
        raise ExistsError(f"{output}: was not made by clgs prepare; remove it or choose another")
    others = sorted({path.name for path in output.iterdir()} - MADE)
    if others:
        raise ExistsError(
            f"{output / others[0]}: was not made by clgs prepare; move it, or choose another folder"
        )
    if any(output.resolve() in path.resolve().parents for path in source):
        raise ExistsError(f"{output}: holds the photos that are read; choose another")


def _prepare(
    source: Source, target: Path, seed: int, quick: bool, on_progress: OnProgress
) -> Verdict:
    expected = source.frames or len(source.files)
    on_progress("read", 0, expected)
    bring_in(source, target / "work", lambda count: on_progress("read", count, expected))
    return reconstruct(target, seed % SEEDS, quick, on_progress)


def _trained(
    verdict: Verdict, target: Path, training: ShortTraining | None, on_progress: OnProgress
) -> Verdict:
    """With what the short training says; it is a test, and none that fails spoils the poses."""
    if training is None:
        return verdict
    start = time.perf_counter()
    try:
        found = training(target, partial(on_progress, "training"))
    except ClgsError as error:
        _log.warning("the poses are not tested by a short training: %s", error)
        return untrained(verdict)
    seconds = {**verdict.seconds, "training": round(time.perf_counter() - start, 1)}
    return replace(with_training(verdict, found), seconds=seconds)


def _write_report(verdict: Verdict, target: Path) -> None:
    images = target / "work" / "images"
    sheet = contact_sheet([images / photo.name for photo in verdict.photos])
    (target / CONTACT_SHEET).write_bytes(sheet)
    report = json.dumps(verdict.plain(), indent=1, allow_nan=False)
    (target / REPORT).write_text(report + "\n", encoding="utf-8")
