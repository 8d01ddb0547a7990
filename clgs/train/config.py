"""Every hyper-parameter of training: its unit, its default and where the default comes from.

Sources: "paper" is Voxel-GS (arXiv 2512.17528); "code" is its public reference implementation,
whose training settings are those of Scaffold-GS. Steps count from 1.
"""

from __future__ import annotations

import hashlib
import math
import tomllib
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import tomli_w

from clgs.constants import NEAR_PLANE
from clgs.errors import DataError, UsageError
from clgs.options import PRESETS, RenderOptions, render_options

BLENDER = "blender"
"""The kind of data set that takes the settings for synthetic scenes; all others are photos."""

SCALED_WITH_STEPS = (
    "statistics_start",
    "growth_start",
    "growth_end",
    "switch_step",
    "mlp_switch_step",
    "learning_rate_steps",
)
"""Moments of a run that move with its length; intervals and counts stay."""

SHORT_RUN_POWERS = {"feature": (0.75, -0.25), "offset": (0.5, 0.25)}
"""A run of 1/n of 30,000 steps multiplies the first and the last of these learning rates by n, at
most 30, to these powers.
"""

CHOICES = {
    "preset": ("default", "quick", "paper"),
    "background": ("black", "white", "random"),
    "proxy": ("channel", "pooled"),
    "accuracy": tuple(PRESETS),
    "adam": ("dense", "visible"),
    "mlp": ("quantized", "float32"),
}
MAY_BE_ZERO = {
    *("seed", "l1_weight", "ssim_weight", "volume_weight", "rate_weight", "voxel", "position_q"),
    *("statistics_start", "growth_start", "growth_end", "switch_step", "growth_threshold"),
    "mlp_switch_step",
    *(
        "max_memory",
        "smallest_anchor",
        "slot_seen",
        "anchor_visits",
        "prune_opacity",
        "fixed_views",
        "checkpoint_interval",
    ),
}
MAY_BE_NEGATIVE = {"scaling_cap"}
WEIGHTS = {"l1_weight", "ssim_weight", "volume_weight", "rate_weight"}
MAX_WEIGHT = 1e6
"""Adam squares the gradients: with weights much above it they overflow, and nothing trains."""


@dataclass(frozen=True)
class LearningRates:
    """(first, last) of each group, log-linear in between; equal ends stay constant (paper, code).

    ``offset`` is multiplied by the scene radius. Positions have learning rate 0: no group.
    """

    offset: tuple[float, float] = (0.01, 0.0001)
    feature: tuple[float, float] = (0.0075, 0.0075)
    scaling: tuple[float, float] = (0.007, 0.007)
    mlp_opacity: tuple[float, float] = (0.002, 2e-5)
    mlp_covariance: tuple[float, float] = (0.004, 0.004)
    mlp_color: tuple[float, float] = (0.008, 5e-5)

    def __post_init__(self) -> None:
        for group in fields(self):
            pair = getattr(self, group.name)
            if not _is_positive_pair(pair):
                raise UsageError(
                    f"learning_rates.{group.name}: {pair!r} is not two positive numbers"
                )
            object.__setattr__(self, group.name, (float(pair[0]), float(pair[1])))


@dataclass(frozen=True)
class TrainConfig:
    """Settings of one training run.

    Build it by :func:`preset`, then :meth:`for_dataset`, then :meth:`scaled`.

    Raises:
        UsageError: a value has the wrong type or range; names the setting.
    """

    preset: str = "default"
    """Which of CHOICES["preset"] the other values come from."""
    steps: int = 30_000
    """Training steps, one view each (paper)."""
    seed: int = 0
    """Of every random choice: MLP weights, view order, growth, random backgrounds, start."""
    normalize: bool = True
    """Recentre the scene and scale it to a camera radius of 4.4; the paper keeps the units."""

    downscale: int = 1
    """Photos are reduced this many times before training."""
    background: str = "black"
    """Behind transparent photos and renders; "random" is a new colour every step (code: black)."""
    accuracy: str = "parity"
    """Of all renders of the run, a name of ``clgs.options.PRESETS``."""
    adam: str = "dense"
    """"dense": every anchor moves at every step; "visible": those that got a gradient."""
    max_memory: int = 0
    """MiB that tile lists, records and rows of gradients may take at a time; 0 is no limit."""
    smallest_anchor: float = 0.0
    """Anchors that are fewer pixels wide on the screen are left out of every render; 0: none."""
    coarse_to_fine: bool = False
    """Whether training begins on reduced photos, see ``schedule.reduction``."""
    near: float = NEAR_PLANE
    """Near plane, scene units (code)."""
    fixed_views: int = 4
    """Training views on which PSNR is logged around the switch step."""
    checkpoint_interval: int = 1000
    """Steps between checkpoints."""
    log_interval: int = 100
    """Steps between rows of progress.csv, each with PSNR on the fixed views."""

    l1_weight: float = 0.8
    """Weight of mean |I - G| (code; the paper's text has 0.2)."""
    ssim_weight: float = 0.2
    """Weight of 1 - SSIM (code; the paper's text has 0.8)."""
    volume_weight: float | None = None
    """Weight of the mean volume of the Gaussians, scene units cubed (Scaffold-GS).

    None: 0.01 on photos, 0 on Blender scenes.
    """
    rate_weight: float = 1e-4
    """Weight of the rate proxy, per bit and anchor (paper)."""
    rate_interval: int = 10
    """Steps between those that add the rate proxy to the loss (code; the paper says each step)."""
    proxy: str = "channel"
    """"channel": one Laplace law a channel, b = std / sqrt(2); "pooled": the code's form."""

    voxel: float = 0.0
    """Edge of a voxel, scene units. 0: 0.005 on photos, 0.001 on Blender scenes (code)."""
    position_q: float = 0.0
    """Q_P, integers per scene unit. 0: 1 / voxel; the paper: 1024 on Synthetic-NeRF, else 200."""
    offset_q: float = 1.0
    """Q_O (paper)."""
    feature_q: float = 1.0
    """Q_A (paper)."""
    scaling_q: float = 8.0
    """Q_S, integers per unit of log scale (paper)."""
    switch_step: int = 15_000
    """Last step without quantisation and rate proxy (paper)."""
    mlp: str = "quantized"
    """"quantized": weights of the MLPs become multiples of the steps of ``train.rounding``."""
    mlp_switch_step: int = 24_000
    """Last step that renders with the weights as they are."""

    statistics_start: int = 500
    """Last step without statistics for growing and pruning (code)."""
    growth_start: int = 1_500
    """Last step at which anchors cannot change (paper); the first change is at 1,600."""
    growth_end: int = 15_000
    """First step at which anchors cannot change any more (paper); the last change is at 14,900."""
    growth_interval: int = 100
    """Steps between changes of the anchors (code). Never scaled."""
    growth_threshold: float = 2e-4
    """Mean screen gradient, NDC units, from which a slot asks for an anchor; doubles a level."""
    growth_levels: int = 3
    """Levels of growth (code); those whose cell is smaller than a voxel are skipped."""
    growth_cell: int = 4
    """Cell of level 0 in voxels, a quarter a level (code; Scaffold-GS: 16 on large scenes)."""
    slot_seen: int = 40
    """A slot may ask once it was seen more often than this (code: 100 * 0.8 * 0.5)."""
    anchor_visits: int = 80
    """An anchor may be pruned once it was visited more often than this (code: 100 * 0.8)."""
    prune_opacity: float = 0.005
    """Summed opacity a visit below which an anchor is pruned (code)."""
    scaling_cap: float = 0.05
    """Largest log scale S[3:6] after pruning: 1.051 scene units (code)."""

    learning_rate_steps: int = 30_000
    """Steps from the first to the last learning rate (code)."""
    learning_rates: LearningRates = field(default_factory=LearningRates)
    """By group."""

    def __post_init__(self) -> None:
        for setting in fields(self):
            object.__setattr__(self, setting.name, _checked(self, setting.name, str(setting.type)))
        if self.l1_weight == self.ssim_weight == 0:
            raise UsageError("l1_weight, ssim_weight: both are 0, so that nothing would be learned")
        _check_order(self)

    def for_dataset(self, kind: str) -> TrainConfig:
        """Values left open (voxel, position_q, volume_weight) chosen for a kind of data set.

        Args:
            kind: "blender" for synthetic scenes; anything else is photos.
        """
        synthetic = kind == BLENDER
        voxel = self.voxel or (0.001 if synthetic else 0.005)
        weight = (0.0 if synthetic else 0.01) if self.volume_weight is None else self.volume_weight
        position_q = self.position_q or _paper_position_q(self.preset, synthetic) or 1.0 / voxel
        return replace(self, voxel=voxel, volume_weight=weight, position_q=position_q)

    def scaled(self, steps: int) -> TrainConfig:
        """The same run squeezed or stretched to ``steps`` steps.

        Start of statistics, growth window, switch step and learning-rate horizon move in
        proportion; the growth interval, the counts 40 and 80 and the proxy's interval stay.

        Learning rates of features and offsets change as SHORT_RUN_POWERS says. Both tensors start
        at zero, and a short run would leave them small beside the rounding to integers when that
        sets in; afterwards large steps would only rattle the integers.
        """
        if steps < 1:
            raise UsageError(f"steps: {steps} is not at least 1")
        moved = {
            name: (getattr(self, name) * steps + self.steps // 2) // self.steps
            for name in SCALED_WITH_STEPS
        }
        moved["learning_rate_steps"] = max(1, moved["learning_rate_steps"])
        shorter = _shortness(steps) / _shortness(self.steps)
        rates = {
            name: tuple(
                rate * shorter**power
                for rate, power in zip(getattr(self.learning_rates, name), powers, strict=True)
            )
            for name, powers in SHORT_RUN_POWERS.items()
        }
        learning_rates = replace(self.learning_rates, **rates)
        return replace(self, steps=steps, learning_rates=learning_rates, **moved)

    def render_options(self) -> RenderOptions:
        """How the run renders."""
        return render_options(self.accuracy, self.max_memory, self.smallest_anchor)

    def to_toml(self) -> str:
        """The text of config.toml: every setting; an open volume weight is left out."""
        table = {name: value for name, value in asdict(self).items() if value is not None}
        return tomli_w.dumps(table)

    def digest(self) -> str:
        """SHA-256 of the settings that results depend on, hexadecimal; the same for equal runs."""
        return hashlib.sha256(replace(self, max_memory=0).to_toml().encode()).hexdigest()


def from_toml(text: str, name: str = "config.toml") -> TrainConfig:
    """The configuration that :meth:`TrainConfig.to_toml` wrote; missing keys take their default.

    Raises:
        DataError: not TOML, an unknown key or a value of the wrong type or range.
    """
    try:
        table = tomllib.loads(text)
        _refuse_unknown(table, TrainConfig, "")
        rates = table.get("learning_rates", {})
        if not isinstance(rates, dict):
            raise UsageError("learning_rates: is not a table")
        _refuse_unknown(rates, LearningRates, "learning_rates.")
        return TrainConfig(**{**table, "learning_rates": LearningRates(**rates)})
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{name}: not a TOML file: {error}; restore or delete it") from error
    except UsageError as error:
        raise DataError(f"{name}: {error}") from error


def preset(name: str) -> TrainConfig:
    """A named configuration.

    "default": 30,000 steps. "quick": the same at 3,000 steps, see :meth:`TrainConfig.scaled`.
    "paper": the data's own units, Q_P as published and the pooled rate proxy, so that published
    numbers can be compared; its loss weights are the code's 0.8 / 0.2, which made those numbers
    (the paper's text says 0.2 / 0.8).

    Raises:
        UsageError: no such preset.
    """
    config = TrainConfig(preset=name)
    if name == "quick":
        return config.scaled(3_000)
    if name == "paper":
        return replace(config, normalize=False, proxy="pooled")
    return config


def _shortness(steps: int) -> float:
    return min(max(TrainConfig.steps / steps, 1.0), 30.0)


def _paper_position_q(preset_name: str, synthetic: bool) -> float:
    return (1024.0 if synthetic else 200.0) if preset_name == "paper" else 0.0


def _refuse_unknown(table: dict[str, Any], kind: type, prefix: str) -> None:
    known = set(kind.__dataclass_fields__)  # type: ignore[attr-defined]  # kind is a dataclass
    for key in table:
        if key not in known:
            raise UsageError(f"unknown key {prefix}{key}; remove it or correct its spelling")


def _checked(config: TrainConfig, name: str, kind: str) -> object:
    """The value of a setting with ints made floats where its type says so."""
    value = getattr(config, name)
    if name in CHOICES and value not in CHOICES[name]:
        raise UsageError(f"{name}: {value!r} is not one of {', '.join(CHOICES[name])}")
    if kind.startswith("float") and not (value is None and kind == "float | None"):
        return _number(name, value)
    if kind == "int":
        if not isinstance(value, int) or isinstance(value, bool):
            raise UsageError(f"{name}: {value!r} is not a whole number")
        _number(name, value)
    if kind == "bool" and not isinstance(value, bool):
        raise UsageError(f"{name}: {value!r} is not true or false")
    return value


def _number(name: str, value: object) -> float:
    """``value`` as a float if it is a finite number in the setting's range."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise UsageError(f"{name}: {value!r} is not a finite number")
    if name in MAY_BE_NEGATIVE:
        return float(value)
    if value < 0 or (value == 0 and name not in MAY_BE_ZERO):
        least = "at least 0" if name in MAY_BE_ZERO else "above 0"
        raise UsageError(f"{name}: {value} is not {least}")
    if name in WEIGHTS and value > MAX_WEIGHT:
        raise UsageError(f"{name}: {value} is above {MAX_WEIGHT:g}, the largest weight")
    return float(value)


def _is_positive_pair(pair: object) -> bool:
    return (
        isinstance(pair, tuple | list)
        and len(pair) == 2
        and all(isinstance(rate, int | float) and 0 < rate < math.inf for rate in pair)
    )


def _check_order(config: TrainConfig) -> None:
    """The moments of a run must follow each other, and anchors must rest after the switch."""
    names = ("statistics_start", "growth_start", "growth_end", "switch_step", "steps")
    for first, second in pairwise(names):
        if getattr(config, first) > getattr(config, second):
            raise UsageError(
                f"{first}: {getattr(config, first)} is after {second} "
                f"{getattr(config, second)}; scale the run by --steps instead"
            )
