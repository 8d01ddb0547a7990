"""What `clgs run` intends: resolution and steps that fit the time, by the speed of this device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

DEFAULT_SECONDS = 600.0
"""For everything, unless the user says otherwise."""

SIZES = (1600, 1280, 960, 800, 640, 480, 400, 320, 240)
"""Widths that photos are reduced to, of which the largest that leaves enough steps is taken."""

ENOUGH_STEPS = 1500
"""Below this, smaller pictures with more steps give the better scene (docs/guide/run.md)."""

MOST_STEPS = 30_000
LEAST_STEPS = 300
"""Fewer give nothing that is worth looking at."""

FEATURE_SECONDS, PAIR_SECONDS = {True: 1.5, False: 3.0}, {True: 0.12, False: 0.5}
"""Of a core, per photo and per pair of photos; with `prepare --quick`, and without."""

FIXED_SECONDS = 5.0

MOST_PAIRS = 40
"""Pairs per photo that are matched in large sets, about."""

POSES_SHARE = 0.45
"""Poses are tested by a second reconstruction if finding them then takes no larger share."""

FRAMES = (100, 80, 60, 50, 40, 30)
"""Frames of a video: the most whose poses take no larger share without that test."""

ROUNDS = 1.3
"""A step of a whole run takes so many times that of a quiet stream: rounds, growth, reading."""

DEEPER = 4.0
"""A pixel of a photo takes so many times one of the synthetic scene: more Gaussians lie one behind
the other.
"""

LATER_STEPS = 650
"""Baking and the clip take as long as so many steps; all else that follows LATER_SECONDS."""

LATER_SECONDS = 8.0


@dataclass(frozen=True)
class Photos:
    """The photos of a run: their number, and the size of the first."""

    count: int
    width: int
    height: int

    def at(self, width: int) -> int:
        """Pixels of a photo that is at most ``width`` wide."""
        reduced = min(width, self.width)
        return reduced * max(1, round(self.height * reduced / self.width))


@dataclass(frozen=True)
class Speed:
    """Seconds of a step: fixed, and per pixel of a photo."""

    fixed: float
    pixel: float

    def step(self, pixels: int) -> float:
        """Seconds of a step on a photo of ``pixels``."""
        return self.fixed + self.pixel * pixels


@dataclass(frozen=True)
class Plan:
    """max_size: photos wider than that are reduced; steps of training; seconds by stage."""

    max_size: int
    steps: int
    prepare_seconds: float
    train_seconds: float
    other_seconds: float

    @property
    def seconds(self) -> float:
        """Of the whole."""
        return self.prepare_seconds + self.train_seconds + self.other_seconds


def fit_speed(measure: Callable[[int], float], edges: tuple[int, int]) -> Speed:
    """The line through the seconds of a step at two square pictures of ``edges`` pixels.

    ``measure`` is of the synthetic scene; pixels of photos take longer.
    """
    small, large = edges
    first, second = measure(small), measure(large)
    pixel = max(0.0, second - first) / (large**2 - small**2)
    return Speed(max(1e-4, first - pixel * small**2), DEEPER * pixel)


def prepare_seconds(count: int, cores: int, quick: bool) -> float:
    """What structure from motion takes for ``count`` photos, as a rule."""
    pairs = min(count * (count - 1) / 2, MOST_PAIRS * count)
    seconds = count * FEATURE_SECONDS[quick] + pairs * PAIR_SECONDS[quick]
    return (seconds + FIXED_SECONDS) / max(1, min(cores, 8))


def must_hurry(count: int, cores: int, seconds: float) -> bool:
    """Whether ``seconds`` for everything leave no time for tests of the poses."""
    return prepare_seconds(count, cores, quick=False) > POSES_SHARE * seconds


def frames_within(cores: int, seconds: float) -> int:
    """Frames of a video that leave time for the rest, if ``seconds`` are for everything."""
    fitting = (n for n in FRAMES if prepare_seconds(n, cores, quick=True) <= POSES_SHARE * seconds)
    return next(fitting, FRAMES[-1])


def make_plan(
    photos: Photos,
    speed: Speed,
    preparing: float,
    seconds: float,
    steps: int | None = None,
    max_size: int | None = None,
) -> Plan:
    """The plan that fits ``seconds``, or has the ``steps`` and the ``max_size`` that are given.

    Args:
        photos: to train on.
        speed: of a step.
        preparing: seconds that the poses take; 0 if they are known.
        seconds: for the whole.
        steps: of training, if chosen by the user.
        max_size: of the photos, likewise.
    """

    def later(width: int) -> float:
        return LATER_SECONDS + LATER_STEPS * speed.step(photos.at(width))

    def affordable(width: int) -> int:
        left = max(0.0, seconds - preparing - later(width))
        return math.floor(left / (ROUNDS * speed.step(photos.at(width))))

    if max_size is None:
        wanted = steps if steps is not None else ENOUGH_STEPS
        fitting = (size for size in SIZES if affordable(size) >= wanted)
        max_size = min(next(fitting, SIZES[-1]), photos.width)
    if steps is None:
        steps = min(max(affordable(max_size), LEAST_STEPS), MOST_STEPS)
    training = steps * ROUNDS * speed.step(photos.at(max_size))
    return Plan(max_size, steps, preparing, training, later(max_size))
