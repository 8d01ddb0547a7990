"""What workflows can be asked for, with the defaults; nothing heavy is imported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clgs.errors import UsageError

PATHS = ("orbit", "spiral", "interpolate")
FRAMES = 120
FPS = 30.0
SIZE = 800, 600

UPS = {
    f"{sign}{axis}": tuple((-1.0 if sign else 1.0) * (axis == other) for other in "xyz")
    for axis in "xyz"
    for sign in ("", "-")
}
"""Directions by the names x, y, z, -x, -y and -z."""

SH_DEGREES = (0, 1, 2, 3)
UNITS = ("data", "scene")
BAKE_STEPS, MOST_BAKE_STEPS = 500, 100_000
"""Steps of refinement after ordinary Gaussians were fitted, and the most of them."""


@dataclass(frozen=True)
class ViewOptions:
    """Which photos a scene is compared with, and how it is drawn.

    What is None is as the run folder of the scene says; if there is none, it is the default.

    Attributes:
        data: folder of the data set.
        split: "train" or "test"; default: "test".
        downscale: the photos are reduced this many times.
        max_size: wider photos are reduced to this width in pixels; 0: never.
        masks: what they mean, "ignore" or "object"; see the training option.
        test_every: every photo of this number is held out, see the training option.
        background: "black" or "white"; default: the scene's own.
        accuracy: a name of ``clgs.options.PRESETS``.
        smallest_anchor: pixels; see the training option.
        max_memory: MiB for the lists of tiles; default: no limit.
        device: number or part of the name; default: the one that ``clgs devices`` marks.
    """

    data: Path | None = None
    split: str | None = None
    downscale: int | None = None
    max_size: int | None = None
    masks: str | None = None
    test_every: int | None = None
    background: str | None = None
    accuracy: str | None = None
    smallest_anchor: float | None = None
    max_memory: int | None = None
    device: str | None = None


@dataclass(frozen=True)
class PathOptions:
    """Where the camera of a clip goes.

    Attributes:
        name: one of PATHS, or a camera path in nerfstudio's form, a .json file.
        frames: their number; default: FRAMES, or that of the file.
        fps: frames per second; default: FPS, or that of the file.
        size: (width, height) of a frame in pixels; default: that of the photos or the file.
        up: a key of UPS, for a scene without a data set; default: a guess.
    """

    name: str = "orbit"
    frames: int | None = None
    fps: float | None = None
    size: tuple[int, int] | None = None
    up: str | None = None


def refuse(options: Mapping[str, Any], why: str) -> None:
    """Raise UsageError, with ``why``, if one of ``options`` is given, which are None if not."""
    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name.replace('_', '-')}: {why}")
