"""The global mapper, in a process of its own.

A library below it draws its random numbers from a state of the whole process: two mappers in one
would change each other's last digits. Nothing but the end of its process stops it, either.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from clgs.machine import repeatedly
from clgs.poses.pycolmap_child import OnStage, quiet_pycolmap, run_child
from clgs.poses.workspace import Workspace

GLOBAL = "global"
"""What reports call it, and the folder of its models."""

MIN_MODEL = 3
"""The least photos of a model."""

ENOUGH_TRACKS = 1000
"""Tracks per photo from which the global mapper finds poses, the longest ones first.

It triangulates all of them afterwards.
"""

ALIVE_SECONDS = 0.5
"""Between two reports that the mapper is at work, at which it can be stopped."""

_TASK = "global mapper"


def map_globally(workspace: Workspace, stage: str) -> list[Any]:
    """Make models: Pan et al., Global Structure-from-Motion Revisited (GLOMAP), 2024.

    Raises:
        CrashError: the process crashed or was killed.
    """
    workspace.on_progress(stage, 0, 0)
    folder = workspace.folder / GLOBAL
    folder.mkdir()
    paths = [str(path) for path in (workspace.database, workspace.images, folder)]
    made = run_child(
        *(__name__, _TASK, [*paths, workspace.seed]),
        lambda _: workspace.on_progress(stage, 0, 0),
    )
    return [workspace.pycolmap.Reconstruction(folder / str(number)) for number in range(made)]


def work(arguments: Any, on_stage: OnStage) -> int:
    """Be the child: pycolmap writes the models as folders 0, 1, ...; returns their number."""
    *paths, seed = arguments
    database, images, folder = map(Path, paths)
    with quiet_pycolmap(_TASK) as pycolmap:
        options = pycolmap.GlobalPipelineOptions()
        mapper, options.min_model_size = options.mapper, MIN_MODEL
        options.num_threads = mapper.num_threads = 1
        mapper.track_required_tracks_per_view = ENOUGH_TRACKS
        positioning = mapper.global_positioning
        rotations, triangulation = mapper.rotation_averaging, mapper.retriangulation
        for one in (options, mapper, rotations, positioning, triangulation):
            one.random_seed = seed
        positioning.use_gpu = mapper.bundle_adjustment.ceres.use_gpu = False
        pycolmap.set_random_seed(seed)
        try:
            with repeatedly(partial(on_stage, None), ALIVE_SECONDS):
                models = Workspace.call(pycolmap.global_mapping, database, images, folder, options)
        except (RuntimeError, ValueError):  # it gives up if no pair determines a rotation
            return 0
    return len(models)
