"""How fast this device trains: on a synthetic scene, or on the data set of the run."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from clgs.data.dataset import LEAST_POINTS, Dataset, load_dataset
from clgs.data.images import Pixels
from clgs.data.view import StoredPhoto, View
from clgs.opencl.device import Device
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform
from clgs.train.config import preset
from clgs.train.run.load import load_for
from clgs.train.run.trainer import Trainer
from clgs.train.step.schedule import COARSE_STAGES
from clgs.workflow.events import Note, OnEvent
from clgs.workflow.runs.plan import Photos, StepSpeed, fit_speed

SYNTHETIC_ANCHORS, EDGES = 12_500, (160, 960)
"""Anchors of the synthetic scene, and pixels of the edges of its two photos."""

REPEATS, WARM_UP = 12, 3
"""Steps that are timed, and steps before them."""

SHALLOWER = 4.0
"""A pixel of a scene that grew from few anchors takes this many times less than a synthetic one.

Fewer Gaussians lie one behind the other.
"""

GROWN = 3_000
"""If there are fewer anchors at the start, they become many more.

The first steps say little of later ones then, which may take as long as those of the synthetic
scene.
"""

WIDTH = 480
"""Pixels of a data set's photos for the timed steps; half of them for the coarse ones."""

VIEWS = 5
"""Photos of a data set that these steps are on: once all were read, reading takes no time."""

EPOCHS = 2
"""Times that each of these photos is seen to warm up, and again to be timed."""


def synthetic_speed(device: Device) -> StepSpeed:
    """The speed of steps on a synthetic scene, which is like that on a usual photo."""

    def measure(edge: int) -> tuple[int, float]:
        config = replace(preset("quick").for_dataset("photos"), start_pixels=0.0)  # all points
        trainer = Trainer(device, synthetic_dataset(edge), config)
        return edge**2, _step_seconds(trainer, WARM_UP, REPEATS)

    return fit_speed(*map(measure, EDGES))


def speed_on(
    device: Device, data: Path, photos: Photos, run: Path, seed: int, on_event: OnEvent
) -> StepSpeed:
    """The speed of the first steps on the data set ``data`` of these photos.

    Points that are found for it are kept in ``run``, the folder of the run.

    Raises:
        ClgsError: it cannot be trained on.
    """
    width = min(WIDTH, photos.width)
    config = replace(preset("quick"), max_size=width, seed=seed)
    dataset = load_dataset(
        data, downscale=config.downscale, max_size=config.max_size, load_images=False
    )
    if len(dataset.points) < LEAST_POINTS:
        dataset = load_for(config, data, run, lambda line: on_event(Note(line)))
    views = dataset.train[:: max(1, len(dataset.train) // VIEWS)][:VIEWS]
    for view in views:
        view.photo.keep()
    dataset = replace(dataset, train=views)
    config = config.for_dataset(dataset.kind)
    trainer = Trainer(device, dataset, config)
    start, steps = trainer.parameters.count, EPOCHS * len(views)
    coarse = Trainer(device, dataset, replace(config, coarse_to_fine=True))
    pixels, ((_, factor),) = photos.at(width), COARSE_STAGES
    found = fit_speed(
        (pixels // factor**2, _step_seconds(coarse, steps + WARM_UP, steps)),
        (pixels, _step_seconds(trainer, steps + WARM_UP, steps)),
    )
    if start >= GROWN:
        return found
    later = synthetic_speed(device)
    pixel = _between(found.pixel, later.pixel / SHALLOWER)
    return StepSpeed(_between(found.fixed, later.fixed), pixel)


def _between(first: float, later: float) -> float:
    """The geometric mean of the seconds of first and of later steps, but at least ``first``."""
    return max(first, math.sqrt(first * later))


def _step_seconds(trainer: Trainer, warm_up: int, repeats: int) -> float:
    """Median seconds of ``repeats`` steps after ``warm_up`` others."""
    times = [time.perf_counter() for _ in trainer.steps(warm_up + repeats)]
    return median(np.diff(times[warm_up - 1 :]))


def synthetic_dataset(edge: int) -> Dataset:
    """A random photo of ``edge`` x ``edge`` pixels, and random points that fill its view."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (edge // 8, edge // 8, 3), np.uint8)
    image = np.ascontiguousarray(coarse.repeat(8, axis=0).repeat(8, axis=1))
    place = np.array([0.0, 0.0, 4.0])
    camera = Camera(np.eye(3), place, edge, edge, edge / 2, edge / 2, edge, edge)
    points = rng.uniform(-1, 1, (SYNTHETIC_ANCHORS, 3)) * (1.7, 1.7, 0.5)
    return Dataset(
        train=[View("synthetic", camera, StoredPhoto.of(Pixels(image, None)))],
        test=[],
        points=points.astype(np.float32),
        point_colors=None,
        transform=SceneTransform(),
        radius=1.0,
        kind="transforms",
        skipped=0,
    )
