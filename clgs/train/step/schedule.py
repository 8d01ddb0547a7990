"""What changes with the step: learning rates, and the size of the pictures."""

from __future__ import annotations

import math
from dataclasses import fields

from clgs.options import PRESETS
from clgs.train.config import TrainConfig

REDUCED_SHARE, REDUCED_BY = 0.35, 2
"""Coarse to fine: up to this share of the steps, photos are reduced this many times."""

OF_ONE_PHOTO = {"exposure"}
"""Groups that learn from one view of a batch: its size does not matter to them."""

TIMES_RADIUS = {"offset"}
"""Groups whose learning rate is multiplied by the scene radius."""


def learning_rates(config: TrainConfig, step: int, scene_radius: float) -> dict[str, float]:
    """Learning rate of every group of :class:`clgs.train.config.LearningRates` at a step.

    Log-linear from first to last over ``config.learning_rate_steps``, constant afterwards
    (Scaffold-GS). ``step``: from 1; ``scene_radius``: 1.1 times the largest camera distance from
    the mean camera centre, scene units, which multiplies the groups of TIMES_RADIUS. Those of a
    batch are multiplied by its root (Grendel-GS, gsplat).
    """
    progress = min(max(step / config.learning_rate_steps, 0.0), 1.0)
    rates = {}
    for group in fields(config.learning_rates):
        first, last = getattr(config.learning_rates, group.name)
        rate = log_linear(first, last, progress)
        rate *= 1.0 if group.name in OF_ONE_PHOTO else math.sqrt(config.batch)
        rates[group.name] = rate * scene_radius if group.name in TIMES_RADIUS else rate
    return rates


def reduction(config: TrainConfig, step: int) -> int:
    """How many times smaller than the photos the render of step number ``step`` (from 1) is."""
    smallest = PRESETS[config.accuracy].downscale
    if not config.coarse_to_fine:
        return smallest
    return max(REDUCED_BY, smallest) if step <= REDUCED_SHARE * config.steps else smallest


def log_linear(first: float, last: float, progress: float) -> float:
    """``first`` at progress 0, ``last`` at 1, linear in the logarithm; constant if they agree."""
    if first == last:
        return first
    return math.exp((1.0 - progress) * math.log(first) + progress * math.log(last))
