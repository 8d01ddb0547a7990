"""The settings that decide about the size of the file: part of the settings of training."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.train.config.option import WEIGHT, Range, at_least, option
from clgs.train.config.run_settings import LEAST_ANCHORS

LEAST_TARGET = {"quantized": 14_000, "float32": 50_000}
"""Bytes of the smallest file that may be asked for: the MLPs take most of it."""

MLP_BYTES = {"quantized": 12_000, "float32": 46_000}
"""Of the MLPs in a file, about."""

ANCHOR_BITS = 223.4
"""Bits of an anchor of the paper, a mean."""

AMPLE = 1.5
"""If a size is asked for: there are at most so many times the anchors that it holds, about. What
has to go once integers have a price leaves each anchor too few digits.
"""

LEARNING = 10
"""Steps below which anchors have nearly no digits yet, and only many of them fill a file."""


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
        open_default="0.9 on photos and 0.33 on Blender scenes, times (steps / 3,000)^0.55; above "
        "3,000 steps, ^0.7",
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
    prune_end: int = option(
        22_500,
        "last step after which anchors are left out that are not worth their bytes",
        at_least(0),
        unit="step number",
        scaled=True,
    )
    freeze_step: int = option(
        28_500,
        "last step at which anchors learn; after it, only the MLPs do",
        at_least(0),
        unit="step number",
        scaled=True,
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
