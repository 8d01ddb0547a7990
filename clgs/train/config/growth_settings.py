"""The settings of growing and pruning: part of the settings of training."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.train.config.option import ANY, at_least, option


@dataclass(frozen=True)
class GrowthSettings:
    """When and where anchors grow, and when transparent ones go (Scaffold-GS)."""

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
        "first step at which anchors cannot change any more, at most switch_step (paper); the last "
        "change is at 14,900",
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
