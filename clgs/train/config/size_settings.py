"""The settings of growing, pruning and the size of the file; part of TrainConfig."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clgs.train.config.option import ANY, WEIGHT, Range, at_least, option, step_number
from clgs.train.config.run_settings import LEAST_ANCHORS

LEAST_TARGET = {"quantized": 14_000, "float32": 50_000}
"""Bytes of the smallest file that may be asked for: the MLPs take most of it."""

MLP_BYTES = {"quantized": 12_000, "float32": 46_000}
"""Bytes that the MLPs take in a file, about."""

ANCHOR_BITS = 223.4
"""Bits of an anchor of the paper, a mean."""

AMPLE = 1.5
"""If a size is asked for, there are at most this many times the anchors that it holds, about. If
more had to go once integers have a price, each anchor would be left too few digits.
"""

GROWTH_THRESHOLD = 2e-4
"""The growth threshold of Scaffold-GS, which runs with the usual price keep."""

LEAST_THRESHOLD = 1e-4
"""The smallest that a small price leads to: half of it doubles the anchors, and so the time."""

LEARNING = 10
"""Steps below which anchors have nearly no digits yet, and only many of them fill a file."""


def size_of(anchors: int, mlp: str) -> int:
    """Bytes of a file with this number of anchors, about; ``mlp`` as the setting says."""
    return max(LEAST_TARGET[mlp], MLP_BYTES[mlp] + math.ceil(ANCHOR_BITS / 8 * anchors))


@dataclass(frozen=True)
class SizeSettings:
    """The price of bytes, and when what is not worth it goes."""

    size_lambda: float | None = option(
        None,
        "what halving the file may cost, the one knob between size and quality: what saves less "
        "than its share is left out; 0: nothing is, and rounding is fine",
        WEIGHT,
        unit="dB per halving",
        group="size",
        open_default="0.9 on photos and 0.33 on Blender scenes, times (steps batch / 3,000)^0.55; "
        "above 3,000, ^0.7",
    )
    target_size: int = option(
        0,
        "bytes of the file, such as 800k or 1.5M; it ends at most 2 % below, never above; lambda "
        "follows from it; 0: as lambda has it",
        Range(LEAST_TARGET["quantized"], or_zero=True),
        unit="bytes",
    )
    max_anchors: int = option(
        0,
        "most anchors at any time, which bounds memory; 0: no limit",
        Range(LEAST_ANCHORS, or_zero=True),
        unit="anchors",
    )
    prune_end: int = step_number(
        22_500, "last step after which anchors are left out that are not worth their bytes"
    )
    freeze_step: int = step_number(
        28_500, "last step at which anchors learn; after it, only the MLPs do"
    )
    proxy: str = option(
        "channel",
        "rate proxy; channel: one Laplace law per channel, b = std / sqrt(2); pooled: the code's "
        "form, which preset paper takes",
        ("channel", "pooled"),
    )
    rate_weight: float = option(
        0.0,
        "weight of the bits of an anchor as the rate proxy estimates them, at every "
        "rate_interval-th step after the switch (code: 1e-4, which preset paper takes)",
        WEIGHT,
        unit="per bit",
    )
    rate_interval: int = option(
        10,
        "steps between those at which the rate proxy looks at all anchors (code)",
        at_least(1),
        unit="steps",
    )


@dataclass(frozen=True)
class GrowthSettings:
    """When and where anchors grow, and when transparent ones go (Scaffold-GS)."""

    statistics_start: int = step_number(
        500,
        "last step without statistics for growing and pruning (code)",
        group="growing and pruning",
    )
    growth_start: int = step_number(
        1_500, "last step at which anchors cannot change (paper); the first change is at 1,600"
    )
    growth_end: int = step_number(
        15_000,
        "first step at which anchors cannot change any more, at most switch_step (paper); the last "
        "change is at 14,900",
    )
    growth_interval: int = option(
        100, "steps between changes of the anchors (code)", at_least(1), unit="steps"
    )
    growth_threshold: float | None = option(
        None,
        "mean screen gradient from which a slot asks for an anchor; doubles per level",
        at_least(0),
        unit="per NDC unit",
        open_default="2e-4 (code); in Blender scenes less if bytes are cheap, down to 1e-4: with a "
        "lambda below the usual one, but above 0, times the root of their ratio; with target_size "
        "as far as the size has room for more anchors",
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
