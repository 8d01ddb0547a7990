"""Every setting of training: its unit, range, default and where the default comes from.

Sources: "paper" is Voxel-GS (arXiv 2512.17528); "code" is its public reference implementation,
whose training settings are those of Scaffold-GS. Steps count from 1.

To add a setting, declare it by :func:`clgs.train.config.option.option`, here or, if it is about
photos, start and learning rates, in ``run_settings``: the command line, the TOML file and the
documentation follow.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from clgs.arguments import check_type, number
from clgs.data.reduction import OBJECT
from clgs.errors import UsageError
from clgs.options import RenderOptions, render_options
from clgs.train.config.option import WEIGHT, at_least, option, options_of, step_number
from clgs.train.config.run_settings import (
    FULL_STEPS,
    LEAST_ANCHORS,
    OBJECTS,
    TRAINED,
    LearningRates,
    PhotoSettings,
    RunSettings,
)
from clgs.train.config.size_settings import (
    AMPLE,
    ANCHOR_BITS,
    GROWTH_THRESHOLD,
    LEARNING,
    LEAST_TARGET,
    LEAST_THRESHOLD,
    MLP_BYTES,
    GrowthSettings,
    SizeSettings,
)

if TYPE_CHECKING:
    from clgs.scene.region import Box

REMEDY = "give six numbers x0,y0,z0,x1,y1,z1, such as -1,-1,-1,1,1,1; inf is a side without end"


def parse_box(text: str) -> Box:
    """The box that the setting ``box`` describes, in scene units.

    Raises:
        UsageError: not six numbers, or a side without length.
    """
    from clgs.scene.region import Box  # imports NumPy, which help does not need

    sides = [number(word) for word in text.split(",")]
    if len(sides) != 6 or None in sides:
        raise UsageError(f"box: {text[:60]!r} is no box; {REMEDY}")
    x0, y0, z0, x1, y1, z1 = (float(side) for side in sides if side is not None)
    try:
        return Box((x0, y0, z0), (x1, y1, z1))
    except UsageError as error:
        raise UsageError(f"{error}; {REMEDY}") from None


BLENDER = "blender"
"""The kind of data set that takes the settings for synthetic scenes; all others are photos."""

LAMBDA = {True: 0.33, False: 0.9}
"""The default lambda of runs of LAMBDA_STEPS, for Blender scenes and for photos."""

LAMBDA_STEPS = 3000

LAMBDA_POWERS = {False: 0.55, True: 0.7}
"""Powers of the steps in runs up to LAMBDA_STEPS and in longer ones. In short runs a high
price would remove what is not learned yet. In long ones a low price would make no file smaller.
"""
PAPER_Q: Mapping[str, Any] = {"offset_q": 1.0, "feature_q": 1.0, "scaling_q": 8.0}
"""Integers per unit of the paper; other runs choose their own."""

FINE_Q: Mapping[str, Any] = {"offset_q": 16.0, "feature_q": 16.0, "scaling_q": 64.0}
"""Integers per unit if bytes have no price: finer than a quarter of the usual lambda chooses."""


MOST_SHORTENED = 100.0
"""A run that is shorter yet has the learning rates of one that is this many times shorter."""

ORDER = ("statistics_start", "growth_start", "growth_end", "switch_step", "freeze_step", "steps")
"""These steps come in this order."""


def default_lambda(kind: str, looks: int) -> float:
    """The lambda of a run on data of ``kind``, see :meth:`TrainConfig.for_dataset`.

    ``looks``: at views, one per step or as many as a batch has.
    """
    power = LAMBDA_POWERS[looks > LAMBDA_STEPS]
    return LAMBDA[kind == BLENDER] * float((looks / LAMBDA_STEPS) ** power)


@dataclass(frozen=True)
class TrainConfig(GrowthSettings, SizeSettings, PhotoSettings, RunSettings):
    """Settings of one training run; ``clgs train --help`` explains each.

    Build it by :func:`clgs.train.config.preset`, then :meth:`for_dataset`, then :meth:`scaled`.

    Raises:
        UsageError: a value has the wrong type or range; names the setting and what to give.
    """

    l1_weight: float = option(
        0.8,
        "weight of the mean of |render - photo| (code; the paper's text has 0.2)",
        WEIGHT,
        unit="none",
        group="loss",
    )
    ssim_weight: float = option(
        0.2, "weight of 1 - SSIM (code; the paper's text has 0.8)", WEIGHT, unit="none"
    )
    volume_weight: float | None = option(
        None,
        "weight of the mean volume of the Gaussians (Scaffold-GS)",
        WEIGHT,
        unit="per cubic scene unit",
        open_default="0.01 on photos, 0 on Blender scenes",
    )
    voxel: float = option(
        0.0,
        "edge of a voxel (code)",
        at_least(0),
        unit="scene units",
        group="quantisation",
        open_default="0.005 on photos, 0.001 on Blender scenes",
    )
    position_q: float = option(
        0.0,
        "integers per unit when positions are rounded, Q_P",
        at_least(0),
        unit="per scene unit",
        open_default="1 / voxel; preset paper: 1024 on Blender scenes, else 200",
    )
    offset_q: float = option(
        0.0,
        "integers per unit when offsets are rounded, Q_O (paper)",
        at_least(0),
        unit="per unit of offset",
    )
    feature_q: float = option(
        0.0,
        "integers per unit when features are rounded, Q_A (paper)",
        at_least(0),
        unit="per unit of feature",
    )
    scaling_q: float = option(
        0.0,
        "integers per unit when scalings are rounded, Q_S (paper)",
        at_least(0),
        unit="per unit of log scale",
    )
    switch_step: int = step_number(15_000, "last step without quantisation and rate proxy (paper)")
    mlp: str = option(
        "quantized",
        "whether the weights of the MLPs are rounded after mlp_switch_step (12 KB of the file), or "
        "stay as they are (46 KB)",
        ("quantized", "float32"),
    )
    mlp_switch_step: int = step_number(
        24_000, "last step that renders with weights of the MLPs that are not rounded"
    )
    optimizer: str = option(
        "device",
        "where Adam runs; numpy: on the host, slower, with the same bits if the device rounds "
        "division and roots correctly",
        ("device", "numpy"),
        group="optimizer",
    )
    adam: str = option(
        "dense",
        "dense: every anchor moves at every step; visible: those that got a gradient",
        ("dense", "visible"),
    )
    average: bool = option(
        True,
        "end with the mean of the parameters over the steps since the last round of pruning, not "
        "with the last step's (preset paper: false)",
        later=True,
    )
    learning_rate_steps: int = option(
        30_000,
        "steps from the first to the last learning rate (code)",
        at_least(1),
        unit="steps",
        scaled=True,
    )
    learning_rates: LearningRates = field(default_factory=LearningRates)

    def __post_init__(self) -> None:
        for name, one in options_of(TrainConfig).items():
            if "." not in name:
                object.__setattr__(self, name, one.check(getattr(self, name)))
        remedy = "dataclasses.replace(config.learning_rates, ...) makes others"
        check_type("learning_rates", self.learning_rates, LearningRates, remedy)
        if self.l1_weight == self.ssim_weight == 0:
            raise UsageError("l1_weight, ssim_weight: both are 0, so nothing would be learned")
        if self.learning_box and self.adam == "visible":
            raise UsageError("box: goes with adam = dense alone; leave out one of the two")
        least = LEAST_TARGET[self.mlp]
        if 0 < self.target_size < least:
            raise UsageError(
                f"target_size: {self.target_size} bytes hardly hold the MLPs; give at least {least}"
            )
        if self.target_size and self.preset == "paper":
            raise UsageError(
                "target_size: preset paper keeps the published integers per unit, which cannot "
                "meet a size; leave out one of the two"
            )
        for first, second in pairwise(ORDER):
            earlier, later = getattr(self, first), getattr(self, second)
            if earlier > later:
                raise UsageError(
                    f"{first}: {earlier} is after {second} {later}; give at most that, "
                    f"or a later {second}"
                )

    @property
    def learning_box(self) -> Box | None:
        """Where anchors learn; None: everywhere."""
        return parse_box(self.box) if self.box else None

    @property
    def held_anchors(self) -> int:
        """How many anchors target_size holds, about; 0: none is asked for."""
        if not self.target_size:
            return 0
        bits = 8 * (self.target_size - MLP_BYTES[self.mlp])
        return max(LEAST_ANCHORS, math.ceil(bits / ANCHOR_BITS))

    @property
    def step_background(self) -> str:
        """The background of training steps: haze around an object would pass for a fixed one."""
        return "random" if self.masks == OBJECT else self.background

    @property
    def most_anchors(self) -> int:
        """Most anchors at any time, by max_anchors and target_size; 0: no limit."""
        ample = math.ceil(AMPLE * self.held_anchors) if self.steps >= LEARNING else 0
        return min(filter(None, (self.max_anchors, ample)), default=0)

    def for_dataset(self, kind: str) -> TrainConfig:
        """Values left open (voxel, position_q, volume_weight, lambda, start_mlps) by kind of data.

        "blender" is a synthetic scene; any other ``kind`` is photos. The growth threshold of
        synthetic scenes follows lambda, or stays open if a size is asked for: growth finds it.
        """
        synthetic = kind == BLENDER
        voxel = self.voxel or (0.001 if synthetic else 0.005)
        weight = (0.0 if synthetic else 0.01) if self.volume_weight is None else self.volume_weight
        paper_q = (1024.0 if synthetic else 200.0) if self.preset == "paper" else 0.0
        position_q = self.position_q or paper_q or 1.0 / voxel
        usual = default_lambda(kind, self.steps * self.batch)
        price = usual if self.size_lambda is None else self.size_lambda
        priced = price > 0 or self.target_size > 0
        fine = {} if priced else {name: getattr(self, name) or q for name, q in FINE_Q.items()}
        return replace(
            self,
            voxel=voxel,
            volume_weight=weight,
            position_q=position_q,
            size_lambda=price,
            growth_threshold=self._threshold(synthetic, price / usual),
            start_mlps=self.start_mlps or (OBJECTS if synthetic else TRAINED),
            **fine,
        )

    def _threshold(self, synthetic: bool, price: float) -> float | None:
        """The growth threshold at ``price`` times the usual lambda; None: growth finds it.

        Cheap bytes buy more from small anchors than from fine digits of few large ones, but among
        photos, which do not agree with each other, that gain is lost. At 0, bytes have no price to
        compare with.
        """
        if self.growth_threshold is not None:
            return self.growth_threshold
        if synthetic and self.target_size:
            return None
        cheap = synthetic and 0.0 < price < 1.0
        return max(LEAST_THRESHOLD, GROWTH_THRESHOLD * (math.sqrt(price) if cheap else 1.0))

    def for_devices(self, count: int) -> TrainConfig:
        """The same run with at least a view per step for each of ``count`` devices.

        Raises:
            UsageError: a batch was asked for that is smaller than that.
        """
        if 1 < self.batch < count:
            raise UsageError(
                f"batch: {self.batch} views per step leave some of {count} devices without one; "
                f"give {count} or more, or fewer devices"
            )
        return replace(self, batch=max(self.batch, count))

    def scaled(self, steps: int) -> TrainConfig:
        """The same run squeezed or stretched to ``steps`` steps.

        Settings declared as ``scaled`` move in proportion. Intervals and counts of views stay, and
        a shorter run has other learning rates, see :meth:`LearningRates.for_shorter_run`.

        Raises:
            UsageError: ``steps`` is not at least 1.
        """
        options_of(TrainConfig)["steps"].check(steps)
        rates = self.learning_rates.for_shorter_run(_shortness(steps) / _shortness(self.steps))
        moved = {
            name: max(one.least, (getattr(self, name) * steps + self.steps // 2) // self.steps)
            for name, one in options_of(TrainConfig).items()
            if one.scaled
        }
        return replace(self, steps=steps, learning_rates=rates, **moved)

    def render_options(self) -> RenderOptions:
        """How the run renders."""
        return render_options(self.accuracy, self.max_memory, self.smallest_anchor)

    def to_toml(self) -> str:
        """The text of config.toml: every setting; those that are open are left out."""
        import tomli_w

        return tomli_w.dumps({n: value for n, value in asdict(self).items() if value is not None})

    def digest(self) -> str:
        """SHA-256 of the settings that results depend on, hexadecimal; the same for equal runs.

        A setting declared as ``later`` counts only if it is not as before there was such a setting,
        so that older runs keep their digest.
        """
        import tomli_w

        kind: type = type(self)
        values = asdict(self)
        for name, one in options_of(kind).items():
            if one.later and values[name] == one.before:
                del values[name]
            elif not one.in_digest:
                values[name] = one.default
        values = {name: value for name, value in values.items() if value is not None}
        return hashlib.sha256(tomli_w.dumps(values).encode()).hexdigest()


def _shortness(steps: int) -> float:
    """How many times shorter a run is than a whole one: 1 to MOST_SHORTENED."""
    return min(max(FULL_STEPS / steps, 1.0), MOST_SHORTENED)
