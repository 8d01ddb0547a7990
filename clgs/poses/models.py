"""Reconstructions by pycolmap's mappers, and the choice of the one that explains the most."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from clgs.errors import DataError
from clgs.poses.job import Job
from clgs.poses.judging.evidence import (
    MAX_CONTRADICTED,
    Evidence,
    Explained,
    explain,
    read_evidence,
)
from clgs.poses.matching import match_again

MIN_MODEL = 3
"""Photos of the smallest model."""

TOLERANCE = 1e-6
"""Relative decrease of the error at which a global bundle adjustment ends."""

LOOSE_INLIERS, LOOSE_SHARE = 15, 0.15
"""Of a photo's matches with points, at the second look; COLMAP's defaults are 30 and 0.25."""

STRONGEST = 8
"""Pairs of a photo that a model is made of if that of all pairs contradicts them."""

MOSTLY_STILL = 0.5
"""Share of the matches that stand still from which that is why there is no model."""

INCREMENTAL, GLOBAL = "incremental", "global"
STRONG = "incremental, strongest pairs"


@dataclass(frozen=True)
class Model:
    """A pycolmap reconstruction, the mapper that made it, and the matches that it explains."""

    mapper: str
    reconstruction: Any
    explained: Explained


@dataclass(frozen=True)
class Choice:
    """The model that is kept, the mappers' largest models, and what other parts were found.

    apart: the names of the photos of each smaller model of the kept one's mapper.
    """

    kept: Model
    candidates: list[Model]
    evidence: Evidence
    apart: list[list[str]]


def build(job: Job, quick: bool) -> Choice:
    """Both mappers' models of all verified matches, the better chosen; quick: incremental alone.

    Raises:
        DataError: no two photos could be related.
    """
    choice = choose(job, (INCREMENTAL,) if quick else (INCREMENTAL, GLOBAL), "poses")
    if choice is None:
        raise DataError(f"no two photos could be related; {_unrelated(read_evidence(job).still)}")
    return choice


def _unrelated(still: float) -> str:
    """What to do if there is no model, and ``still`` of the matches stand still in the pictures."""
    if still < MOSTLY_STILL:
        return "take more, overlapping photos of a textured, motionless scene"
    return (
        f"{still:.0%} of what they share stands still in the pictures: if a thing turned before a "
        "camera that did not move, mask all else (masks/NAME.png); else move between photos"
    )


def choose(job: Job, mappers: Sequence[str], stage: str) -> Choice | None:
    """The model that explains the most of the matches in links; None if there is no model.

    If it contradicts links, a model of the strongest pairs alone may take its place.
    """
    evidence = read_evidence(job)
    # Each mapper runs on one thread: sums in another order would be other poses.
    with ThreadPoolExecutor(len(mappers)) as pool:
        running = {name: pool.submit(MAPPERS[name], job, stage) for name in mappers}
        found = {name: future.result() for name, future in running.items()}
    candidates = _candidates(found, evidence)
    if not candidates:
        return None
    if max(candidates, key=_explained).explained.contradicted > MAX_CONTRADICTED:
        found[STRONG] = map_strongest(job, evidence, stage)
        candidates = _candidates(found, evidence)
    kept = max(candidates, key=_explained)
    return Choice(kept, candidates, evidence, _apart(kept.reconstruction, found[kept.mapper]))


def _candidates(found: Mapping[str, list[Any]], evidence: Evidence) -> list[Model]:
    """The largest model of each mapper that made one."""
    best = {name: max(models, key=_size) for name, models in found.items() if models}
    return [Model(name, model, explain(model, evidence)) for name, model in best.items()]


def look_again(job: Job, choice: Choice) -> Choice:
    """Try once more, less strictly, to place the photos that the kept model lacks."""
    model = choice.kept.reconstruction
    placed = {model.image(number).name for number in model.reg_image_ids()}
    left_out = [place for place, name in enumerate(job.names) if name not in placed]
    if not left_out:
        return choice
    match_again(job, left_out)
    folder = job.folder / "first_look"
    folder.mkdir()
    model.write(folder)
    options = _incremental_options(job)
    options.multiple_models = False
    options.mapper.abs_pose_min_num_inliers = LOOSE_INLIERS
    options.mapper.abs_pose_min_inlier_ratio = LOOSE_SHARE
    again = _run_incremental(job, "more poses", job.folder / "second_look", options, folder)
    evidence = read_evidence(job)
    found = [model, *again]
    models = [Model(choice.kept.mapper, one, explain(one, evidence)) for one in found]
    kept = max(models, key=_explained)
    return replace(choice, kept=kept, evidence=evidence)


def map_incrementally(job: Job, stage: str) -> list[Any]:
    """COLMAP's incremental mapper: Schönberger and Frahm, Structure-from-Motion Revisited, 2016."""
    return _run_incremental(job, stage, job.folder / INCREMENTAL, _incremental_options(job))


def map_globally(job: Job, stage: str) -> list[Any]:
    """The global mapper: Pan et al., Global Structure-from-Motion Revisited (GLOMAP), 2024."""
    job.on_progress(stage, 0, 0)
    options = job.pycolmap.GlobalPipelineOptions()
    options.num_threads = 1
    options.random_seed = job.seed
    options.min_model_size = MIN_MODEL
    options.mapper.num_threads = 1
    options.mapper.random_seed = job.seed
    options.mapper.rotation_averaging.random_seed = job.seed
    options.mapper.global_positioning.random_seed = job.seed
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    options.mapper.retriangulation.random_seed = job.seed
    folder = job.folder / GLOBAL
    folder.mkdir()
    try:
        models = job.call(job.pycolmap.global_mapping, job.database, job.images, folder, options)
    except (RuntimeError, ValueError):  # it gives up where no pair tells a rotation
        return []
    return list(models.values())


def map_strongest(job: Job, evidence: Evidence, stage: str) -> list[Any]:
    """The incremental mapper's models of the strongest pairs of every photo.

    Among things that are repeated, weak pairs lead astray: a photo joins another side of the scene
    before the photos beside it are placed.
    """
    part = replace(job, folder=job.folder / "strongest")
    part.folder.mkdir()
    shutil.copyfile(job.database, part.database)
    kept = {(pair.first, pair.second) for pair in evidence.strongest(STRONGEST)}
    with part.open() as database:
        for pair in evidence.pairs:
            if (pair.first, pair.second) not in kept:
                database.delete_two_view_geometry(pair.first, pair.second)
    return map_incrementally(part, "other poses" if stage == "poses" else stage)


MAPPERS = {INCREMENTAL: map_incrementally, GLOBAL: map_globally}


def _incremental_options(job: Job) -> Any:
    options = job.pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = job.seed
    options.mapper.num_threads = 1
    options.mapper.random_seed = job.seed
    options.triangulation.random_seed = job.seed
    options.min_model_size = MIN_MODEL
    options.ba_global_function_tolerance = TOLERANCE
    return options


def _run_incremental(
    job: Job, stage: str, folder: Path, options: Any, start: Path | None = None
) -> list[Any]:
    """Models of the incremental mapper, from the model in the folder ``start`` on if given."""
    folder.mkdir()
    total = len(job.names)
    placed = 0

    def count() -> None:
        nonlocal placed
        placed = min(placed + 1, total)
        job.on_progress(stage, placed, total)

    job.on_progress(stage, 0, total)
    models = job.call(
        job.pycolmap.incremental_mapping,
        job.database,
        job.images,
        folder,
        options=options,
        input_path=start or "",
        next_image_callback=count,
    )
    job.on_progress(stage, total, total)  # what was not placed will not be
    return list(models.values())


def _explained(model: Model) -> int:
    return model.explained.total


def _size(model: Any) -> tuple[int, int]:
    return model.num_reg_images(), model.num_points3D()


def _apart(kept: Any, models: list[Any]) -> list[list[str]]:
    """Photos of each other model that the kept one lacks."""
    placed = set(_names(kept))
    others = [[name for name in _names(one) if name not in placed] for one in models]
    return sorted(filter(None, others), key=len, reverse=True)


def _names(model: Any) -> list[str]:
    return sorted(model.image(number).name for number in model.reg_image_ids())
