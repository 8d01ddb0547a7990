"""Raw photos or a video to a COLMAP data set: structure from motion by pycolmap."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clgs.data.photos.bring_in import Source, bring_in, find_source
from clgs.data.pycolmap_lazy import SEEDS
from clgs.data.sfm.mapper import reconstruct
from clgs.errors import DataError, ExistsError, OutputError
from clgs.files import atomic_folder, check_folder, is_full

STAGES = ("read", "features", "matches", "poses", "undistort")
"""What ``prepare`` reports as it begins it."""


@dataclass(frozen=True)
class PrepareSummary:
    """registered of total photos; points; error: mean reprojection error in pixels."""

    registered: int
    total: int
    points: int
    error: float


def prepare(
    photos: Path | str,
    output: Path | str,
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
    overwrite: bool = False,
    frames: int | None = None,
) -> PrepareSummary:
    """Poses and points of the photos in and below ``photos``, or of a video, in ``output``.

    ``output`` gets images/ (undistorted), masks/ if photos are masked, and sparse/0/ (binary,
    pinhole cameras); it appears complete or not at all. A warning names the files that are
    skipped. ``frames``: taken of a video. ``on_stage`` is called with each of STAGES. With
    ``overwrite`` it may replace what an earlier call made.

    Raises:
        DataError: too few or damaged photos, no reconstruction, no pycolmap.
        OutputError: ``output`` is not empty, or cannot be made.
        OSError: the disk is full, or another fault of ``output``.
    """
    source, output = find_source(Path(photos), frames), Path(output)
    try:
        check_folder(output.parent)
        output.parent.mkdir(parents=True, exist_ok=True)
        if overwrite:
            _check_replaceable(output, source.files)
        with atomic_folder(output, overwrite) as target:
            return _prepare(source, target, seed, on_stage)
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
    if any(output.resolve() in path.resolve().parents for path in source):
        raise ExistsError(f"{output}: holds the photos that are read; choose another")


def _prepare(
    source: Source, target: Path, seed: int, on_stage: Callable[[str], None]
) -> PrepareSummary:
    on_stage("read")
    work = target / "work"
    work.mkdir()
    sizes = bring_in(source, work)
    model = reconstruct(target, set(sizes), seed % SEEDS, on_stage)
    shutil.rmtree(work)
    return PrepareSummary(model.registered, len(sizes), model.points, model.error)
