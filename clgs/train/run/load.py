"""The data set of a training run, loaded as its settings say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from clgs.data.dataset import Dataset, load_dataset
from clgs.data.point_file import PointFile
from clgs.data.points import RandomStart
from clgs.data.reduction import Reduction
from clgs.data.stored_photo import PhotoMemory
from clgs.train.config import TrainConfig


def load_for(
    config: TrainConfig,
    data: str | Path,
    cache: Path,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Dataset:
    """The data set in the folder ``data`` for a run with these settings.

    Args:
        config: of the run, need not be resolved for the data set.
        data: as of :func:`clgs.load_dataset`.
        cache: the run folder, which keeps triangulated points.
        on_stage: called with a line before work that takes minutes.

    Raises:
        DataError: as of :func:`clgs.load_dataset`.
    """
    points: PointFile | RandomStart = RandomStart(
        config.start_points, config.start_volume == "hull"
    )
    if config.points:
        points = PointFile(Path(config.points), config.point_samples)
    return load_dataset(
        data,
        downscale=Reduction(config.downscale, config.max_size),
        preset_units=not config.normalize,
        cache=cache,
        seed=config.seed,
        load_images=PhotoMemory(config.photo_memory * 2**20),
        load_points=points,
        on_stage=on_stage,
    )
