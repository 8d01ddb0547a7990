"""The data set of a training run, loaded as its settings say, and the points to start from."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from clgs.data.dataset import LEAST_POINTS, Dataset, load_dataset, to_scene_points
from clgs.data.points import random_points, viewpoint
from clgs.errors import DataError
from clgs.poses.triangulate import triangulate
from clgs.train.config import TrainConfig

MIN_TRIANGULATED = 100
"""Fewer triangulated points count as a failure."""

_log = logging.getLogger(__name__)


def load_for(
    config: TrainConfig,
    data: str | Path,
    cache: Path,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Dataset:
    """The data set in the folder ``data`` for a run with these settings, with points.

    ``config`` need not be resolved for the data set; ``cache`` and ``on_stage`` as for
    :func:`with_points`.

    Raises:
        DataError: as of :func:`clgs.load_dataset` and :func:`with_points`.
    """
    dataset = load_dataset(
        data,
        downscale=config.downscale,
        max_size=config.max_size,
        preset_units=not config.normalize,
        photo_memory=config.photo_memory * 2**20,
        points_file=Path(config.points) if config.points else None,
        point_samples=config.point_samples,
        seed=config.seed,
        masks=config.masks,
        test_every=config.test_every,
        fisheye_view=config.fisheye_view,
    )
    return with_points(dataset, config, cache, on_stage)


def with_points(
    dataset: Dataset,
    config: TrainConfig | None = None,
    cache: Path | None = None,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Dataset:
    """The data set with points to start training from, which it may have already.

    Points for photos that come with poses alone are triangulated, which takes minutes. If too few
    are found, and for Blender scenes, random points are drawn in the volume that cameras share.

    Args:
        dataset: its folder still holds the photos.
        config: of the run, for the seed and the random points; default: ``TrainConfig()``.
        cache: folder that keeps triangulated points, as the user's cache folder does; never the
            data folder.
        on_stage: called with a line before work that takes minutes.

    Raises:
        DataError: no two photos look at the same place.
    """
    config = config or TrainConfig()
    if len(dataset.points) >= LEAST_POINTS or not dataset.train:
        return dataset
    if dataset.kind == "colmap":
        _log.warning(_TOO_FEW, dataset.folder, len(dataset.points))
    elif must_triangulate(dataset):
        dataset = _triangulated(dataset, cache, config.seed, on_stage)
        if len(dataset.points) >= LEAST_POINTS:
            return dataset
    viewpoints = [viewpoint(view.camera, view.photo.pixels().alpha) for view in dataset.train]
    start = config.seed, config.start_points, config.start_volume == "hull"
    points = random_points(viewpoints, dataset.radius, dataset.kind == "blender", *start)
    if len(points) < LEAST_POINTS:
        raise DataError(
            f"{dataset.folder}: no two photos look at the same place; check the poses and their "
            "axes"
        )
    return replace(dataset, points=points, point_colors=None)


def must_triangulate(dataset: Dataset) -> bool:
    """Whether :func:`with_points` triangulates points, which takes minutes."""
    return len(dataset.points) < LEAST_POINTS and dataset.kind not in ("colmap", "blender")


_TOO_FEW = "%s: only %d usable points, starting from random ones"


def _triangulated(
    dataset: Dataset, cache: Path | None, seed: int, on_stage: Callable[[str], None]
) -> Dataset:
    """The data set with points triangulated from its training photos, or without any."""
    names = {view.name for view in dataset.train}
    photos = [photo for photo in dataset.photos if photo.name in names]
    try:
        found = triangulate(photos, cache, seed, on_stage)
    except DataError as error:
        _log.warning("no triangulated points, starting from random ones: %s", error)
        return dataset
    if len(found.position) < MIN_TRIANGULATED:
        count = len(found.position)
        _log.warning("only %d points triangulated, starting from random ones", count)
        return dataset
    points, colors = to_scene_points(dataset, found.position, found.color)
    if len(points) < LEAST_POINTS:
        _log.warning(_TOO_FEW, dataset.folder, len(points))
    return replace(dataset, points=points, point_colors=colors)
