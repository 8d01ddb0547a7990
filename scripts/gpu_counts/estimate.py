"""Counts of small scenes scaled to the benches, a lower bound of the time on a card, and tables.

No card has confirmed the estimate: each limit is taken as if everything else were free, memory
answered at once and no work waited for other work. Real times are longer.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from units import Sums, Work, scaled, units_of

LANES = 32
SECTOR = 32
COLUMNS = (
    "launches | warp instructions, millions | SIMT efficiency | sector efficiency "
    "| wavefronts over ideal | estimate, µs | what binds |"
)
NAMES = (
    *("lane_instructions", "lane_operations", "warp_instructions", "warp_special"),
    *("global_used_read", "global_used_written", "global_sectors_read", "global_sectors_written"),
    *("global_wavefronts", "group_sectors_read", "compulsory_read", "compulsory_written"),
    *("local_wavefronts", "local_ideal_wavefronts"),
)
"""Counts that an estimate is made of."""

Json = Mapping[str, Any]


@dataclass(frozen=True)
class Card:
    """Public figures of a card.

    schedulers: of a multiprocessor, each issues an instruction of a warp a cycle; fp32_lanes and
    special_lanes of a multiprocessor; clock in Hz; dram and l2 in bytes per second; launch in
    seconds.
    """

    name: str
    multiprocessors: int
    schedulers: int
    fp32_lanes: int
    special_lanes: int
    clock: float
    dram: float
    l2: float
    launch: float


H100 = Card("H100 SXM", 132, 4, 128, 16, 1.755e9, 3.35e12, 5.5e12, 2.5e-6)


def limits(sums: Sums, groups: float, group: float, card: Card = H100) -> dict[str, float]:
    """Microseconds that every limit of a card asks for.

    ``sums``: the plugin's, of all launches of a kernel; ``groups``: work-groups of a launch, of
    ``group`` work-items each. Too few of them leave multiprocessors and schedulers without work.
    """
    warps = max(1.0, groups * max(1.0, group / LANES))
    processors = min(float(card.multiprocessors), max(1.0, groups))
    schedulers = min(processors * card.schedulers, warps)
    special = schedulers * card.special_lanes / card.schedulers
    wavefronts = sums["local_wavefronts"] + sums["global_wavefronts"]
    sectors = sums["group_sectors_read"] + sums["global_sectors_written"]
    compulsory = sums["compulsory_read"] + sums["compulsory_written"]
    operations = processors * card.fp32_lanes * 2
    seconds = {
        "issue": sums["warp_instructions"] / schedulers / card.clock,
        "FP32": sums["lane_operations"] / operations / card.clock,
        "special functions": sums["warp_special"] * LANES / special / card.clock,
        "shared memory and L1": wavefronts / processors / card.clock,
        "L2": sectors * SECTOR / card.l2,
        "DRAM": compulsory / card.dram,
    }
    return {name: 1e6 * value for name, value in seconds.items()}


@dataclass(frozen=True)
class Estimate:
    """A kernel, or kernels that run one after the other: launches, scaled counts and a bound.

    microseconds: what binds each kernel, its largest limit, and the launches.
    """

    launches: int
    sums: Sums
    microseconds: dict[str, float]

    @property
    def time(self) -> float:
        """Microseconds in all."""
        return sum(self.microseconds.values())

    def cells(self) -> str:
        """The cells of a line after its names, see COLUMNS."""
        sums = self.sums
        simt = _share(sums["lane_instructions"], LANES * sums["warp_instructions"])
        used = sums["global_used_read"] + sums["global_used_written"]
        sectors = sums["global_sectors_read"] + sums["global_sectors_written"]
        conflicts = _share(sums["local_wavefronts"], sums["local_ideal_wavefronts"])
        binds = max(self.microseconds, key=self.microseconds.__getitem__)
        return (
            f"{self.launches} | {sums['warp_instructions'] / 1e6:.2f} | {simt:.0%} "
            f"| {_share(used, SECTOR * sectors):.0%} | {conflicts:.2f} | {self.time:.0f} | {binds}"
        )


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 1.0


def total(found: Iterable[Estimate]) -> Estimate:
    """Add up kernels that run one after the other."""
    launches, sums, microseconds = 0, dict.fromkeys(NAMES, 0.0), dict[str, float]()
    for one in found:
        launches += one.launches
        sums = {name: sums[name] + one.sums[name] for name in NAMES}
        for name, value in one.microseconds.items():
            microseconds[name] = microseconds.get(name, 0.0) + value
    return Estimate(launches, sums, microseconds)


def known_works(state: Json, key: str) -> list[tuple[Work, Sums]]:
    """What is known of a kernel, the smallest scene first.

    Sorts and prefix sums are known from many elements alone, others from steps; from another stage
    if a kernel is not in this one.
    """
    kernel, scenes = key.split(": ")[1], list(state["scenes"].values())

    def anywhere(scenes: Sequence[Json]) -> str | None:
        keys = (key for scene in scenes for key in scene["kernels"])
        return next((key for key in keys if key.endswith(f": {kernel}")), None)

    if anywhere(elements := list(state["elements"].values())):
        scenes, key = elements, f"elements: {kernel}"
    if not any(key in scene["kernels"] for scene in scenes):
        key = anywhere(scenes) or key
    known = [
        (Work(scene["kernels"][key]["launches"], scene["units"]), scene["kernels"][key]["sums"])
        for scene in scenes
        if key in scene["kernels"]
    ]
    return sorted(known, key=lambda one: one[1]["work_items"])


def kernels(state: Json, bench: str) -> dict[str, Estimate]:
    """Every kernel of a bench by its stage and name, in the order of the step."""
    target, found = state["benches"][bench], {}
    for key, each in target["kernels"].items():
        if not (known := known_works(state, key)):
            continue
        launches = each["launches"]
        work, count = Work(launches, target["units"]), len(launches)
        sums = dict.fromkeys(NAMES, 0.0) | scaled(key.split(": ")[1], known, work)
        groups = sum(launch["items"] / launch["group"] for launch in launches) / count
        name, value = max(
            limits(sums, groups, launches[0]["group"]).items(), key=lambda item: item[1]
        )
        times = {name: value, "launches": 1e6 * count * H100.launch}
        found[key] = Estimate(count, sums, times)
    return found


def by_stage(state: Json, bench: str) -> Iterator[str]:
    """A line per stage, and one for all, as Markdown."""
    yield f"| stage | {COLUMNS}"
    yield "|" + "---|" * 8
    found = kernels(state, bench)
    for stage in dict.fromkeys(key.split(": ")[0] for key in found):
        own = [one for key, one in found.items() if key.startswith(f"{stage}: ")]
        yield f"| {stage} | {total(own).cells()} |"
    yield f"| **all** | {total(found.values()).cells()} |"


def by_kernel(state: Json, bench: str) -> Iterator[str]:
    """A line per kernel, the slowest first, as Markdown."""
    yield f"| kernel | unit | {COLUMNS}"
    yield "|" + "---|" * 9
    for key, one in sorted(kernels(state, bench).items(), key=lambda item: -item[1].time):
        units = " and ".join(units_of(key.split(": ")[1]))
        yield f"| {key} | {units} | {one.cells()} |"
