"""Models by pycolmap's mappers, and the choice of the one that explains the most matches."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from clgs.errors import DataError
from clgs.poses.evidence import (
    MAX_CONTRADICTED,
    STRONG_PAIR,
    Evidence,
    MappedModel,
    ModelChoice,
    explain,
)
from clgs.poses.judge import LOW_RATIO, MAX_DROPPED
from clgs.poses.known import map_known
from clgs.poses.stages.global_mapper import GLOBAL, MIN_MODEL, map_globally
from clgs.poses.stages.matching import match_again, read_evidence
from clgs.poses.workspace import Workspace

TOLERANCE = 1e-6
"""Relative decrease of the error at which a global bundle adjustment ends."""

GROWTH, REFINEMENTS = 1.4, 2
"""The incremental mapper adjusts all poses whenever photos or points have grown by this factor, at
most as often; COLMAP's defaults, 1.1 and 5, take half as long again for the same poses."""

LOOSE_INLIERS, LOOSE_SHARE = 15, 0.15
"""The least matches with points that a photo needs at the second look, and their least share;
COLMAP's defaults are 30 and 0.25."""

STRONGEST = 8
"""Pairs per photo from which a model is made if the model of all pairs contradicts matches."""

MOSTLY_STILL = 0.5
"""If no model is found, this share of motionless matches is taken for the reason."""

MANY = 150
"""Above this number of photos the global mapper is asked first: the incremental one's time grows
with the square of the number."""

INCREMENTAL, GIVEN = "incremental", "given poses"
STRONG = "incremental, strongest pairs"
STRONGEST_PAIRS = "strongest"
"""Folder of the last one's files."""


def map_photos(workspace: Workspace, evidence: Evidence, quick: bool) -> ModelChoice:
    """Find a model by one mapper, and by the others in turn if the first model leaves doubt.

    Poses that are given are refined first. The incremental mapper is the surer one; of more than
    MANY photos the global one is faster. ``evidence``: of the workspace; ``quick``: ask no second
    mapper.

    Raises:
        DataError: no two photos could be related.
    """
    for made in (*MAPPERS, STRONGEST_PAIRS):  # from other matches
        shutil.rmtree(workspace.folder / made, ignore_errors=True)
    found, choice = dict[str, list[Any]](), None
    asked = mappers(workspace)
    for mapper in asked[:1] if quick or not evidence.pairs else asked:
        found[mapper] = map_by(mapper, workspace, _stage(found))
        choice = _choose(workspace, found, evidence)
        if choice is None:
            continue
        # Photos may lack a pose, or contradict it; then another model may be a better one.
        explained = choice.kept.explained
        lacking = (explained.explained < 0) & (explained.matches >= STRONG_PAIR)
        least = min(explained.inlier_ratios().values(), default=0.0)
        contradicted = explained.contradicted > MAX_CONTRADICTED
        if not (lacking.any() or contradicted or least < LOW_RATIO):
            break
    if choice is not None:
        return choice
    still = evidence.still
    if still < MOSTLY_STILL:
        advice = "take more, overlapping photos of a textured, motionless scene"
    else:
        advice = (
            f"{still:.0%} of what they share stands still in the pictures: if a thing turned "
            "before a camera that did not move, mask all else (masks/NAME.png); else move between "
            "photos"
        )
    raise DataError(f"no two photos could be related; {advice}")


def mappers(workspace: Workspace) -> list[str]:
    """List the mappers that may be asked, in their order."""
    both = [INCREMENTAL, GLOBAL] if len(workspace.names) <= MANY else [GLOBAL, INCREMENTAL]
    return [GIVEN, *both] if workspace.known else both


def ask_all_mappers(
    workspace: Workspace, choice: ModelChoice, doubtful: Collection[str]
) -> ModelChoice:
    """Choose once more, with models of the mappers that were not asked yet.

    In place of the incremental mapper's own model, a few ``doubtful`` photos of many are placed
    again. If all mappers were asked, that is tried as well.
    """
    found = dict(choice.found)
    asked = [one for one in mappers(workspace) if one not in found]
    for mapper in asked:
        if mapper == INCREMENTAL and _are_few(doubtful, workspace):
            found[mapper] = _place_again(workspace, choice, doubtful, "other poses")
        else:
            found[mapper] = map_by(mapper, workspace, _stage(found))
    if asked:
        return _choose(workspace, found, choice.evidence) or choice
    return replace_doubtful(workspace, choice, doubtful, "other poses")


def replace_doubtful(
    workspace: Workspace, choice: ModelChoice, doubtful: Collection[str], stage: str
) -> ModelChoice:
    """Place a few doubtful photos again; ``choice`` itself unless that explains more matches."""
    if not _are_few(doubtful, workspace):
        return choice
    again = [
        MappedModel(choice.kept.mapper, one, explain(one, choice.evidence))
        for one in _place_again(workspace, choice, doubtful, stage)
    ]
    kept = best_model([choice.kept, *again])
    if kept is choice.kept:
        return choice
    others = [one for one in choice.candidates if one is not choice.kept]
    return replace(choice, kept=kept, candidates=[kept, *others])


def _are_few(doubtful: Collection[str], workspace: Workspace) -> bool:
    return len(doubtful) <= MAX_DROPPED * len(workspace.names)


def _place_again(
    workspace: Workspace, choice: ModelChoice, doubtful: Collection[str], stage: str
) -> list[Any]:
    """Have the incremental mapper place photos again, from the others' poses in the kept model."""
    copy, folder = workspace.folder / "without_doubt", workspace.folder / "placed_again"
    for one in (copy, folder):
        shutil.rmtree(one, ignore_errors=True)
    copy.mkdir()
    choice.kept.reconstruction.write(copy)
    model = workspace.pycolmap.Reconstruction(copy)
    for name in set(doubtful).intersection(_names(model)):
        model.deregister_frame(model.find_image_with_name(name).frame_id)
    return workspace.models(
        stage,
        lambda: _run_incremental(workspace, stage, folder, _incremental_options(workspace), model),
    )


def _stage(found: Mapping[str, list[Any]]) -> str:
    return "other poses" if found else "poses"


def _choose(
    workspace: Workspace, found: dict[str, list[Any]], evidence: Evidence
) -> ModelChoice | None:
    """Choose the model that explains the most matches in links; None if there is no model.

    If the best of all mappers contradicts links, a model of the strongest pairs alone may take its
    place; it is added to ``found``, the models of each mapper.
    """
    candidates = largest_models(found, evidence)
    if not candidates:
        return None
    best = best_model(candidates).explained
    if best.contradicted > MAX_CONTRADICTED and found.keys() >= set(mappers(workspace)):
        found[STRONG] = map_strongest(workspace, evidence, "other poses")
        candidates = largest_models(found, evidence)
    kept = best_model(candidates)
    placed = set(_names(kept.reconstruction))
    others = [[name for name in _names(one) if name not in placed] for one in found[kept.mapper]]
    apart = sorted(filter(None, others), key=len, reverse=True)
    return ModelChoice(kept, candidates, evidence, apart, found)


def largest_models(found: Mapping[str, list[Any]], evidence: Evidence) -> list[MappedModel]:
    """Pick the largest model of each mapper that made one, and count what it explains."""
    best = {
        name: max(models, key=lambda one: (one.num_reg_images(), one.num_points3D()))
        for name, models in found.items()
        if models
    }
    return [MappedModel(name, model, explain(model, evidence)) for name, model in best.items()]


def best_model(models: Sequence[MappedModel]) -> MappedModel:
    """Choose the model that explains the most matches."""
    return max(models, key=lambda one: one.explained.total)


def _names(model: Any) -> list[str]:
    return sorted(model.image(number).name for number in model.reg_image_ids())


def look_again(workspace: Workspace, choice: ModelChoice) -> ModelChoice:
    """Try once more, less strictly, to place the photos that the kept model lacks."""
    model = choice.kept.reconstruction
    placed = set(_names(model))
    left_out = [place for place, name in enumerate(workspace.names) if name not in placed]
    if not left_out:
        return choice
    match_again(workspace, left_out)
    options = _incremental_options(workspace)
    options.mapper.abs_pose_min_num_inliers = LOOSE_INLIERS
    options.mapper.abs_pose_min_inlier_ratio = LOOSE_SHARE
    folder, stage = workspace.folder / "second_look", "more poses"
    again = workspace.models(
        stage, lambda: _run_incremental(workspace, stage, folder, options, model)
    )
    evidence = read_evidence(workspace)
    found = [model, *again]
    models = [MappedModel(choice.kept.mapper, one, explain(one, evidence)) for one in found]
    kept = best_model(models)
    return choice if kept is models[0] else replace(choice, kept=kept, evidence=evidence)


def map_by(mapper: str, workspace: Workspace, stage: str) -> list[Any]:
    """Make models by one of MAPPERS, unless that is finished."""
    return workspace.models(stage, lambda: MAPPERS[mapper](workspace, stage))


def _map_incrementally(workspace: Workspace, stage: str) -> list[Any]:
    """COLMAP's incremental mapper: Schönberger and Frahm, Structure-from-Motion Revisited, 2016."""
    options = _incremental_options(workspace)
    return _run_incremental(workspace, stage, workspace.folder / INCREMENTAL, options)


def _map_from_given(workspace: Workspace, stage: str) -> list[Any]:
    """Refine the given poses, and place the photos without one from there on."""
    total = len(workspace.names)
    workspace.on_progress(stage, 0, total)
    folder = workspace.folder / GIVEN
    model = map_known(workspace, folder)
    if not model.num_points3D():
        return []
    if len(workspace.known) == total:
        workspace.on_progress(stage, total, total)
        return [model]
    options = _incremental_options(workspace)
    return _run_incremental(workspace, stage, folder / "all", options, model) or [model]


MAPPERS = {INCREMENTAL: _map_incrementally, GLOBAL: map_globally, GIVEN: _map_from_given}


def map_strongest(workspace: Workspace, evidence: Evidence, stage: str) -> list[Any]:
    """Run the incremental mapper on the strongest pairs of every photo.

    Among repeated things weak pairs mislead: a photo joins another side of the scene before its
    neighbours are placed.
    """
    strongest = replace(workspace, folder=workspace.folder / STRONGEST_PAIRS)
    strongest.folder.mkdir()
    shutil.copyfile(workspace.database, strongest.database)
    kept = {(pair.first, pair.second) for pair in evidence.strongest(STRONGEST)}
    with strongest.open() as database:
        for pair in evidence.pairs:
            if (pair.first, pair.second) not in kept:
                database.delete_two_view_geometry(pair.first, pair.second)
    return map_by(INCREMENTAL, strongest, stage)


def _incremental_options(workspace: Workspace) -> Any:
    options = workspace.pipeline_options()
    options.min_model_size = MIN_MODEL
    options.ba_global_function_tolerance = TOLERANCE
    options.ba_global_frames_ratio = options.ba_global_points_ratio = GROWTH
    options.ba_global_max_refinements = REFINEMENTS
    return options


def _run_incremental(
    workspace: Workspace, stage: str, folder: Path, options: Any, start: Any | None = None
) -> list[Any]:
    """Run the incremental mapper, from the model ``start`` on if that is given."""
    folder.mkdir()
    total = len(workspace.names)
    if start is not None:
        options.multiple_models = False
        (folder / "start").mkdir()
        start.write(folder / "start")
    count = workspace.counter(stage, 0, total)
    models = workspace.call(
        workspace.pycolmap.incremental_mapping,
        workspace.database,
        workspace.images,
        folder,
        options=options,
        input_path="" if start is None else folder / "start",
        next_image_callback=lambda: count(1),
    )
    workspace.on_progress(stage, total, total)  # photos that were not placed will not be
    return list(models.values())
