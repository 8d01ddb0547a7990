"""Every setting of training: its unit, range, default and where the default comes from.

Sources: "paper" is Voxel-GS (arXiv 2512.17528); "code" is its public reference implementation,
whose training settings are those of Scaffold-GS. Steps count from 1.

To add a setting, declare it here by :func:`clgs.train.config.option.option`: the command line, the
TOML file and the documentation follow.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, replace

import tomli_w

from clgs.constants import NEAR_PLANE
from clgs.errors import UsageError
from clgs.options import PRESETS, RenderOptions, render_options
from clgs.train.config.learning_rates import LearningRates
from clgs.train.config.option import (
    ANY,
    POSITIVE,
    WEIGHT,
    Range,
    Text,
    at_least,
    option,
    options_of,
)
from clgs.train.config.photo_settings import PhotoSettings
from clgs.train.config.run_length import FULL_STEPS, check_order, scaled_moments, shortness

BLENDER = "blender"
"""The kind of data set that takes the settings for synthetic scenes; all others are photos."""

MAX_PIXELS = 65536
"""No picture is wider."""

MAX_SAMPLES = 20_000_000
"""No device of today has memory for more anchors."""


@dataclass(frozen=True)
class TrainConfig(PhotoSettings):
    """Settings of one training run; ``clgs train --help`` explains each.

    Build it by :func:`clgs.train.config.preset`, then :meth:`for_dataset`, then :meth:`scaled`.

    Raises:
        UsageError: a value has the wrong type or range; names the setting and what to give.
    """

    preset: str = option(
        "default",
        "where the other values start from; quick: 3,000 steps; paper: published constants and "
        "the data's own units",
        ("default", "quick", "paper"),
        group="run",
    )
    steps: int = option(
        FULL_STEPS,
        "training steps, one view each (paper); another number than the preset's also moves, in "
        "proportion, the settings that say so, and in short runs it changes the learning rates of "
        "features and offsets",
        at_least(1),
        unit="steps",
    )
    seed: int = option(
        0,
        "of all random choices: MLP weights, order of views, growth, random backgrounds, start",
        at_least(0),
        unit="none",
    )
    normalize: bool = option(
        True, "recentre the scene and scale it to a camera radius of 4.4; the paper keeps the units"
    )
    coarse_to_fine: bool = option(
        False, "train on reduced photos first: a quarter of the size, then half"
    )
    points: str = option(
        "",
        "start from the points of this file instead of the data set's: PLY, OBJ, GLB, STL, OFF or "
        "XYZ, in the data set's world units; surfaces are sampled, colors ignored, GLB turned from "
        "y up as `clgs export` does",
        Text("the name of a file"),
        in_digest=False,  # the points themselves are in it
    )
    point_samples: int = option(
        100_000,
        "points drawn from the surfaces in the file of points",
        Range(4, MAX_SAMPLES),
        unit="points",
        in_digest=False,
    )
    fixed_views: int = option(
        4, "training views on which PSNR is logged", at_least(0), unit="views"
    )
    log_interval: int = option(
        100,
        "steps between rows of progress.csv, each with the PSNR of the fixed views",
        at_least(1),
        unit="steps",
    )
    checkpoint_interval: int = option(
        1000,
        "steps between checkpoints; 0: only when the run is interrupted",
        at_least(0),
        unit="steps",
    )

    background: str = option(
        "black",
        "color behind transparent photos and unfinished pixels (code: black); random: a new one "
        "every step",
        ("black", "white", "random"),
        group="rendering",
    )
    accuracy: str = option(
        "parity",
        "exact: nearly nothing is truncated; parity: as in 3DGS; fast: below a third of a level "
        "from it; preview: half the resolution, enlarged",
        tuple(PRESETS),
    )
    smallest_anchor: float = option(
        0.0,
        "leave out anchors that are fewer pixels wide on the screen: faster, another picture; "
        "0: none",
        Range(0, MAX_PIXELS),
        unit="pixels",
    )
    near: float = option(
        NEAR_PLANE,
        "distance of the near plane from the camera (code)",
        POSITIVE,
        unit="scene units",
    )
    max_memory: int = option(
        0,
        "draw in groups of tiles whose lists and gradients take at most this much; slower, the "
        "same result; 0: no limit",
        at_least(0),
        unit="MiB",
        in_digest=False,
    )

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
    rate_weight: float = option(
        1e-4,
        "weight of the rate proxy, the estimated size of an anchor (paper)",
        WEIGHT,
        unit="per bit",
    )
    rate_interval: int = option(
        10,
        "steps between those that add the rate proxy to the loss (code; the paper: every step)",
        at_least(1),
        unit="steps",
    )
    proxy: str = option(
        "channel",
        "rate proxy; channel: one Laplace law per channel, b = std / sqrt(2); pooled: the code's "
        "form, which preset paper takes",
        ("channel", "pooled"),
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
        1.0,
        "integers per unit when offsets are rounded, Q_O (paper)",
        POSITIVE,
        unit="per unit of offset",
    )
    feature_q: float = option(
        1.0,
        "integers per unit when features are rounded, Q_A (paper)",
        POSITIVE,
        unit="per unit of feature",
    )
    scaling_q: float = option(
        8.0,
        "integers per unit when scalings are rounded, Q_S (paper)",
        POSITIVE,
        unit="per unit of log scale",
    )
    switch_step: int = option(
        15_000,
        "last step without quantisation and rate proxy (paper)",
        at_least(0),
        unit="step number",
        scaled=True,
    )
    mlp: str = option(
        "quantized",
        "whether the weights of the MLPs are rounded after mlp_switch_step (12 KB of the file), or "
        "stay as they are (46 KB)",
        ("quantized", "float32"),
    )
    mlp_switch_step: int = option(
        24_000,
        "last step that renders with weights of the MLPs that are not rounded",
        at_least(0),
        unit="step number",
        scaled=True,
    )

    statistics_start: int = option(
        500,
        "last step without statistics for growing and pruning (code)",
        at_least(0),
        unit="step number",
        group="growing and pruning",
        scaled=True,
    )
    growth_start: int = option(
        1_500,
        "last step at which anchors cannot change (paper); the first change is at 1,600",
        at_least(0),
        unit="step number",
        scaled=True,
    )
    growth_end: int = option(
        15_000,
        "first step at which anchors cannot change any more (paper); the last change is at 14,900",
        at_least(0),
        unit="step number",
        scaled=True,
    )
    growth_interval: int = option(
        100, "steps between changes of the anchors (code)", at_least(1), unit="steps"
    )
    growth_threshold: float = option(
        2e-4,
        "mean screen gradient from which a slot asks for an anchor; doubles per level",
        at_least(0),
        unit="per NDC unit",
    )
    growth_levels: int = option(
        3,
        "levels of growth (code); those whose cell is smaller than a voxel are skipped",
        at_least(1),
        unit="levels",
    )
    growth_cell: int = option(
        4,
        "edge of a cell of level 0, a quarter per level (code; Scaffold-GS: 16 on large scenes)",
        at_least(1),
        unit="voxels",
    )
    slot_seen: int = option(
        40,
        "a slot may ask once it was seen more often than this (code: 100 * 0.8 * 0.5)",
        at_least(0),
        unit="views",
    )
    anchor_visits: int = option(
        80,
        "an anchor may be pruned once it was visited more often than this (code: 100 * 0.8)",
        at_least(0),
        unit="views",
    )
    prune_opacity: float = option(
        0.005,
        "summed opacity per visit below which an anchor is pruned (code)",
        at_least(0),
        unit="none",
    )
    scaling_cap: float = option(
        0.05,
        "largest log scale of a shape after pruning: exp(0.05) is 1.051 scene units (code)",
        ANY,
        unit="log of scene units",
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
        if self.l1_weight == self.ssim_weight == 0:
            raise UsageError("l1_weight, ssim_weight: both are 0, so nothing would be learned")
        check_order(vars(self))

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

        Settings declared as ``scaled`` move in proportion: start of statistics, growth window,
        switch steps, learning-rate horizon. The growth interval, the counts 40 and 80 and the
        proxy's interval stay.

        Learning rates change as :meth:`LearningRates.for_shorter_run` says.

        Raises:
            UsageError: ``steps`` is not at least 1.
        """
        options_of(TrainConfig)["steps"].check(steps)
        shorter = shortness(steps) / shortness(self.steps)
        rates = self.learning_rates.for_shorter_run(shorter)
        moved = scaled_moments(options_of(TrainConfig), vars(self), steps)
        return replace(self, steps=steps, learning_rates=rates, **moved)

    def render_options(self) -> RenderOptions:
        """How the run renders."""
        return render_options(self.accuracy, self.max_memory, self.smallest_anchor)

    def to_toml(self) -> str:
        """The text of config.toml: every setting; an open volume weight is left out."""
        return tomli_w.dumps({n: value for n, value in asdict(self).items() if value is not None})

    def digest(self) -> str:
        """SHA-256 of the settings that results depend on, hexadecimal; the same for equal runs."""
        free = {n: one.default for n, one in options_of(TrainConfig).items() if not one.in_digest}
        return hashlib.sha256(replace(self, **free).to_toml().encode()).hexdigest()


def _paper_position_q(preset_name: str, synthetic: bool) -> float:
    return (1024.0 if synthetic else 200.0) if preset_name == "paper" else 0.0
