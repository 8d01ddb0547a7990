"""How fast this device trains: on a synthetic scene, or on the data set of the run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from statistics import median

from clgs.cli.run.plan import Photos, Speed, fit_speed
from clgs.cli.tell import tell
from clgs.data.dataset import LEAST_POINTS, Dataset, load_dataset
from clgs.lab.bench.step import stream_times, synthetic_trainer
from clgs.opencl.device import Device
from clgs.train.config import TrainConfig, preset
from clgs.train.run.load import load_for
from clgs.train.run.trainer import Trainer
from clgs.train.step.schedule import COARSE_STAGES

TYPICAL_GAUSSIANS = 50_000
"""Gaussians of the synthetic scene."""

EDGES = (160, 960)
"""Pixels of its pictures' edges."""

REPEATS = 12
"""Steps that are timed on each."""

DEEPER = 4.0
"""A pixel of a photo takes so many times one of the synthetic scene: more Gaussians lie one behind
the other.
"""

GROWN = 3_000
"""Fewer anchors than these at the start become many more: their steps say little of later ones,
which may take as long as those of the synthetic scene.
"""

WIDTH = 480
"""Of photos of a data set, on which steps are timed; and of half the size."""

VIEWS = 5
"""Photos that these steps are on: once all of them were read, reading takes no time."""

EPOCHS = 2
"""Of these photos, to warm up, and to be timed."""


def synthetic_speed(device: Device) -> Speed:
    """Of steps on a photo, guessed from those on a synthetic scene."""
    found = _synthetic(device)
    return replace(found, pixel=DEEPER * found.pixel)


def _synthetic(device: Device) -> Speed:
    """Of steps on the synthetic scene."""

    def measure(edge: int) -> tuple[int, float]:
        trainer = synthetic_trainer(device, TYPICAL_GAUSSIANS, edge, 0)
        return edge**2, median(stream_times(trainer, REPEATS)) / 1e3

    return fit_speed(*map(measure, EDGES))


def speed_on(device: Device, data: Path, photos: Photos, run: Path, seed: int) -> Speed:
    """Of the first steps on a data set.

    Args:
        device: that will train.
        data: the data set.
        photos: what it holds.
        run: folder of the run, which keeps points that are found for it.
        seed: of the run.

    Raises:
        ClgsError: it cannot be trained on.
    """
    width = min(WIDTH, photos.width)
    config = replace(preset("quick"), max_size=width, seed=seed)
    dataset = _some_photos(config, data, run)
    config = config.for_dataset(dataset.kind)
    pixels, ((_, factor),) = photos.at(width), COARSE_STAGES
    trainer = Trainer(device, dataset, config)
    start = trainer.parameters.count
    coarse = _first_steps(Trainer(device, dataset, replace(config, coarse_to_fine=True)))
    found = fit_speed((pixels // factor**2, coarse), (pixels, _first_steps(trainer)))
    if start >= GROWN:
        return found
    usual = _synthetic(device)
    return Speed(_between(found.fixed, usual.fixed), _between(found.pixel, usual.pixel))


def _between(first: float, later: float) -> float:
    """Halfway by ratio from what first steps take to what later ones do, if that is more."""
    return max(first, math.sqrt(first * later))


def _some_photos(config: TrainConfig, data: Path, run: Path) -> Dataset:
    """The data set with some of its photos, read; the others are not, if its points are known."""
    dataset = load_dataset(
        data, downscale=config.downscale, max_size=config.max_size, load_images=False
    )
    if len(dataset.points) < LEAST_POINTS:
        dataset = load_for(config, data, run, tell)
    views = dataset.train[:: max(1, len(dataset.train) // VIEWS)][:VIEWS]
    for view in views:
        view.photo.keep()
    return replace(dataset, train=views)


def _first_steps(trainer: Trainer) -> float:
    """Seconds of one."""
    steps = EPOCHS * len(trainer.dataset.train)
    for _ in trainer.steps(steps):
        pass
    return median(stream_times(trainer, steps)) / 1e3
