"""How settings follow the length of a run, and the order of its moments."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from clgs.errors import UsageError
from clgs.train.config.option import Option

FULL_STEPS = 30_000
"""Steps of a whole run (paper)."""

MOST_SHORTENED = 100.0
"""Learning rates change no more in runs that are shorter still."""

ORDER = ("statistics_start", "growth_start", "growth_end", "switch_step", "freeze_step", "steps")
"""Anchors must be there before the switch, and learn after it."""


def shortness(steps: int) -> float:
    """How many times shorter than a whole run: 1 to MOST_SHORTENED."""
    return min(max(FULL_STEPS / steps, 1.0), MOST_SHORTENED)


def scaled_moments(
    options: Mapping[str, Option], values: Mapping[str, Any], steps: int
) -> dict[str, Any]:
    """The moments of a run, moved in proportion from ``values["steps"]`` to ``steps`` steps."""
    before = values["steps"]
    return {
        name: max(one.least, (values[name] * steps + before // 2) // before)
        for name, one in options.items()
        if one.scaled
    }


def check_order(values: Mapping[str, Any]) -> None:
    """Raise UsageError unless the moments of a run follow each other."""
    for first, second in pairwise(ORDER):
        if values[first] > values[second]:
            raise UsageError(
                f"{first}: {values[first]} is after {second} {values[second]}; give at most that, "
                f"or a later {second}"
            )
