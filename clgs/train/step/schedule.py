"""What changes with the step: learning rates and the order of views."""

from __future__ import annotations

import copy
import math
from dataclasses import fields
from typing import Any

import numpy as np

from clgs.options import PRESETS
from clgs.train.config import TrainConfig

COARSE_STAGES = ((0.35, 2),)
"""Coarse to fine: up to this share of the steps, photos are reduced this many times."""

TIMES_RADIUS = {"offset"}
"""Groups whose learning rate is multiplied by the scene radius."""


def learning_rates(config: TrainConfig, step: int, scene_radius: float) -> dict[str, float]:
    """Learning rate of every group of :class:`clgs.train.config.LearningRates` at a step.

    Log-linear from first to last over ``config.learning_rate_steps``, constant afterwards
    (Scaffold-GS).

    Args:
        config: gives the ends and the horizon.
        step: from 1.
        scene_radius: 1.1 times the largest camera distance from the mean camera centre, scene
            units; multiplies the groups of TIMES_RADIUS.
    """
    progress = min(max(step / config.learning_rate_steps, 0.0), 1.0)
    rates = {}
    for group in fields(config.learning_rates):
        first, last = getattr(config.learning_rates, group.name)
        rate = log_linear(first, last, progress)
        rates[group.name] = rate * scene_radius if group.name in TIMES_RADIUS else rate
    return rates


def reduction(config: TrainConfig, step: int) -> int:
    """How many times smaller than the photos the render of step number ``step`` (from 1) is."""
    smallest = PRESETS[config.accuracy].downscale
    if not config.coarse_to_fine:
        return smallest
    stages = (factor for share, factor in COARSE_STAGES if step <= share * config.steps)
    return max(next(stages, 1), smallest)


def log_linear(first: float, last: float, progress: float) -> float:
    """``first`` at progress 0, ``last`` at 1, linear in the logarithm; constant if they agree."""
    if first == last:
        return first
    return math.exp((1.0 - progress) * math.log(first) + progress * math.log(last))


def restore_rng(state: dict[str, Any]) -> np.random.Generator:
    """The generator whose ``bit_generator.state`` was saved; continues with the same numbers."""
    rng = np.random.default_rng()
    rng.bit_generator.state = state
    return rng


class ViewSampler:
    """Deals every view once per epoch, in a new random order each time (paper)."""

    def __init__(self, count: int, seed: int) -> None:
        """Views 0 .. ``count`` - 1; the same seed gives the same order."""
        if count < 1:
            raise ValueError("count: there is no view to sample")
        self._count = count
        self._rng = np.random.default_rng(seed)
        self._order: list[int] = []
        self._next = 0

    def next(self) -> int:
        """Number of the next view."""
        if self._next == len(self._order):
            self._order = self._rng.permutation(self._count).tolist()
            self._next = 0
        self._next += 1
        return self._order[self._next - 1]

    def upcoming(self, count: int) -> list[int]:
        """Numbers of the next ``count`` views, without taking them; at most one epoch ahead."""
        coming = self._order[self._next : self._next + count]
        if len(coming) < count:
            coming += copy.deepcopy(self._rng).permutation(self._count).tolist()
        return coming[:count]

    def state(self) -> dict[str, Any]:
        """All that :meth:`restore` needs to continue exactly, ready for JSON."""
        return {
            "count": self._count,
            "order": list(self._order),
            "next": self._next,
            "rng": self._rng.bit_generator.state,
        }

    @classmethod
    def restore(cls, state: dict[str, Any]) -> ViewSampler:
        """The sampler that gave ``state``."""
        sampler = cls(state["count"], 0)
        sampler._rng = restore_rng(state["rng"])
        sampler._order = list(state["order"])
        sampler._next = state["next"]
        return sampler
