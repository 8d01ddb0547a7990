"""What the work of every kernel grows with, and counts scaled to a larger scene by it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

UNITS: dict[str, tuple[str, ...]] = {
    "adam": ("parameters",),
    "adam_check": ("groups",),
    "blend_backward": ("entries",),
    "blend_forward": ("pairs forward",),
    "blend_gather": ("entries",),
    "blend": ("Gaussians",),
    "cull": ("anchors",),
    "density_gradient": ("Gaussians",),
    "density": ("anchors",),
    "loss_volume": ("Gaussians",),
    "loss": ("groups",),
    "mlp_backward_sum": ("launches", "count"),
    "mlp": ("visible anchors",),
    "neural": ("Gaussians",),
    "project": ("Gaussians",),
    "scan_fits": ("launches",),
    "scan": ("count", "groups squared"),
    "sort": ("count", "groups squared"),
    "tiles_ranges": ("entries",),
    "tiles": ("Gaussians",),
}
"""The units of a kernel, by its name or by what that begins with.

count: elements, the sum over all launches. groups: work-groups. groups squared: each of them reads
what all others left.
"""

DEPENDENT = 1e-9
"""Two equations whose determinant is this small, relative to its terms, are one."""

Sums = Mapping[str, float]


@dataclass(frozen=True)
class Work:
    """What one kernel did in one stage of a step: its launches, and the units of the scene."""

    launches: Sequence[Mapping[str, Any]]
    scene: Mapping[str, float]

    def amount(self, unit: str) -> float:
        """How many of a unit."""
        if unit == "launches":
            return len(self.launches)
        if unit == "count":
            return float(sum(launch["count"] for launch in self.launches))
        if unit == "groups":
            return float(sum(one["items"] / one["group"] for one in self.launches))
        if unit == "groups squared":
            return float(sum((one["items"] / one["group"]) ** 2 for one in self.launches))
        return float(self.scene[unit])


def units_of(kernel: str) -> tuple[str, ...]:
    """The units of a kernel; of one that is not known, launches."""
    fits = [name for name in UNITS if kernel.startswith(name)]
    return UNITS[max(fits, key=len)] if fits else ("launches",)


def scaled(kernel: str, known: Sequence[tuple[Work, Sums]], target: Work) -> dict[str, float]:
    """Counts of ``target`` from those of smaller scenes, the largest of them last."""
    units = units_of(kernel)
    names = sorted({name for _, sums in known for name in sums})
    return {name: _scaled(units, known[-2:], target, name) for name in names}


def _scaled(
    units: tuple[str, ...], known: Sequence[tuple[Work, Sums]], target: Work, name: str
) -> float:
    """Scale by both units if two scenes give both shares and none is negative, else by one."""
    amounts = [[work.amount(unit) for unit in units] for work, _ in known]
    values = [float(sums.get(name, 0)) for _, sums in known]
    wanted = [target.amount(unit) for unit in units]
    if len(units) == 2 and len(known) == 2:
        (a, b), (c, d) = amounts
        determinant = a * d - b * c
        if abs(determinant) > DEPENDENT * abs(a * d):
            first = (values[0] * d - b * values[1]) / determinant
            second = (a * values[1] - values[0] * c) / determinant
            if first >= 0 and second >= 0:
                return first * wanted[0] + second * wanted[1]
    return values[-1] * wanted[0] / amounts[-1][0] if amounts[-1][0] else 0.0
