"""Scales the counts of small scenes to the benches, and estimates the time on a card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from roofline import LANES, SECTOR, Bound, Sum, bound, total
from units import Sums, Work, scaled

Json = Mapping[str, Any]


@dataclass(frozen=True)
class Kernel:
    """A kernel in a stage of a bench: its launches, its scaled counts and its bound."""

    stage: str
    name: str
    launches: int
    sums: Sums
    bound: Bound


@dataclass(frozen=True)
class Row:
    """The same of a stage, or of all."""

    launches: int
    sums: Sums
    bound: Sum

    @property
    def warp_instructions(self) -> float:
        """Issued, in millions."""
        return self.sums["warp_instructions"] / 1e6

    @property
    def simt_efficiency(self) -> float:
        """Share of lanes that work when an instruction is issued."""
        return _share(self.sums["lane_instructions"], LANES * self.sums["warp_instructions"])

    @property
    def sector_efficiency(self) -> float:
        """Bytes that a warp uses of those in the sectors that it touches."""
        used = self.sums["global_used_read"] + self.sums["global_used_written"]
        sectors = self.sums["global_sectors_read"] + self.sums["global_sectors_written"]
        return _share(used, SECTOR * sectors)

    @property
    def conflicts(self) -> float:
        """Wavefronts of shared memory over those without bank conflicts; 1 if there are none."""
        return _share(self.sums["local_wavefronts"], self.sums["local_ideal_wavefronts"])


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 1.0


NAMES = (
    *("lane_instructions", "lane_operations", "warp_instructions", "warp_special"),
    *("global_used_read", "global_used_written", "global_sectors_read", "global_sectors_written"),
    *("global_wavefronts", "group_sectors_read", "compulsory_read", "compulsory_written"),
    *("local_wavefronts", "local_ideal_wavefronts"),
)
"""Counts that an estimate is made of."""


def works(state: Json, key: str) -> list[tuple[Work, Sums]]:
    """What is known of a kernel, the smallest scene first.

    Sorts and prefix sums are known from many elements alone, others from steps; from another stage
    if a kernel is not in this one.
    """
    kernel, own = key.split(": ")[1], "scenes"
    if any(key_of(each, kernel) for each in state["elements"].values()):
        own, key = "elements", f"elements: {kernel}"
    scenes = list(state[own].values())
    if not any(key in scene["kernels"] for scene in scenes):
        key = next((found for each in scenes if (found := key_of(each, kernel))), key)
    known = [
        (Work(scene["kernels"][key]["launches"], scene["units"]), scene["kernels"][key]["sums"])
        for scene in scenes
        if key in scene["kernels"]
    ]
    return sorted(known, key=lambda one: one[1]["work_items"])


def key_of(scene: Json, kernel: str) -> str | None:
    """A kernel of a scene, in any stage."""
    return next((key for key in scene["kernels"] if key.endswith(f": {kernel}")), None)


def kernels(state: Json, bench: str) -> list[Kernel]:
    """Every kernel of a bench, in the order of the step."""
    target = state["benches"][bench]
    return [
        one
        for key, each in target["kernels"].items()
        if (one := _kernel(state, key, Work(each["launches"], target["units"])))
    ]


def _kernel(state: Json, key: str, target: Work) -> Kernel | None:
    known, (stage, name) = works(state, key), key.split(": ")
    if not known:
        return None
    sums = dict.fromkeys(NAMES, 0.0) | scaled(name, known, target)
    count = len(target.launches)
    groups = sum(launch["items"] / launch["group"] for launch in target.launches) / count
    limit = bound(sums, count, groups, target.launches[0]["group"])
    return Kernel(stage, name, count, sums, limit)


def rows(found: list[Kernel]) -> dict[str, Row]:
    """The kernels of each stage together, in the order of the step."""
    stages = dict.fromkeys(one.stage for one in found)
    return {stage: row([one for one in found if one.stage == stage]) for stage in stages}


def row(found: list[Kernel]) -> Row:
    """Add up some kernels."""
    sums = {name: sum(one.sums[name] for one in found) for name in NAMES}
    return Row(sum(one.launches for one in found), sums, total(one.bound for one in found))
