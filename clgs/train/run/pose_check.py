"""Whether a short training can show every photo: a wrong pose cannot be shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import Dataset, load_dataset
from clgs.data.reduction import Reduction
from clgs.opencl.device import Device
from clgs.train.config import preset
from clgs.train.config.settings import PAPER_Q
from clgs.train.quality.metrics import Used
from clgs.train.quality.score_views import Pictures, ViewScore, evaluate_views
from clgs.train.run.trainer import Trainer

SIZE = 120
"""Pixels, the photos' width."""

VISITS = 8
"""Training steps per photo."""

LEAST_STEPS, MOST_STEPS = 300, 3000

LEAST_VARIANCE = 1e-4
"""The least variance assumed of a photo: a standard deviation of 2.6 in 255."""


def check_poses(
    folder: Path, device: Device, on_step: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, float]:
    """The share of the variance that stays unexplained, for each photo of a data set by name.

    A short training on all photos, small, without a price for bytes. A photo that the others
    contradict, because its pose is wrong or because it shows something before the camera that they
    do not show, cannot be learned together with them. The same seed and device give the same bits.

    Args:
        folder: a data set with poses.
        device: to train on.
        on_step: called with the steps that are done, and their number.

    Raises:
        DataError: the data set or a photo is damaged.
        ClgsError: training failed.
    """
    dataset = load_dataset(folder, downscale=Reduction(0, SIZE))
    return unexplained(dataset, device, on_step)


def unexplained(
    dataset: Dataset, device: Device, on_step: Callable[[int, int], None]
) -> dict[str, float]:
    """Do what :func:`check_poses` does, with a data set whose photos are small already."""
    views = [*dataset.train, *dataset.test]
    steps = min(max(LEAST_STEPS, VISITS * len(views)), MOST_STEPS)
    config = preset("default").for_dataset(dataset.kind).scaled(steps)
    config = replace(config, size_lambda=0.0, **PAPER_Q)
    trainer = Trainer(device, replace(dataset, train=views, test=[]), config)
    for result in trainer.steps(steps):
        on_step(result.step, steps)
    used = {view.name: view.used() for view in views}
    found = {}

    def keep(score: ViewScore, pictures: Pictures) -> None:
        found[score.name] = unexplained_share(pictures.render, pictures.photo, used[score.name])

    evaluate_views(device, trainer.quantized_scene(), views, keep)
    return found


def unexplained_share(
    render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8], used: Used = None
) -> float:
    """The photo's variance about its mean colour that a render does not explain, a share of 0 to 1.

    After the brightness and contrast of each channel that fit best: a photo that was exposed
    otherwise is no wrong one. 0: the same picture; 1: no better than one colour.

    Args:
        render: (H, W, 3) uint8.
        photo: likewise.
        used: as in :mod:`clgs.train.quality.metrics`.
    """
    chosen = slice(None) if used is None or not used.any() else used != 0
    x, y = (picture.astype(np.float64)[chosen] / 255.0 for picture in (render, photo))
    x, y = (one.reshape(-1, 3) - one.reshape(-1, 3).mean(axis=0) for one in (x, y))
    shared = np.maximum((x * y).sum(axis=0), 0.0)  # a negative of the photo explains nothing
    contrast = shared / np.maximum(np.square(x).sum(axis=0), np.finfo(np.float64).tiny)
    variance = float(np.square(y).mean())
    return float(np.square(contrast * x - y).mean()) / max(variance, LEAST_VARIANCE)
