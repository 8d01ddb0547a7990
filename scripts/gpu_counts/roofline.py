"""A lower bound of the time of launches on a GPU, from counts and the card's public figures.

An estimate that no card has confirmed: each limit is taken as if everything else were free, memory
answered at once and no work waited for other work. Real times are longer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

LANES = 32
SECTOR = 32


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


@dataclass(frozen=True)
class Bound:
    """Microseconds: of every limit, of all launches; ``time`` is the largest limit and these."""

    limits: dict[str, float]
    launches: float

    @property
    def time(self) -> float:
        """The estimate."""
        return max(self.limits.values()) + self.launches

    @property
    def binds(self) -> str:
        """What takes longest."""
        return max({**self.limits, "launches": self.launches}.items(), key=lambda one: one[1])[0]


def bound(
    sums: Mapping[str, float], launches: int, groups: float, group: float, card: Card = H100
) -> Bound:
    """The bound of ``launches`` launches of a kernel.

    ``sums``: the plugin's, of all launches; ``groups``: work-groups of a launch, of ``group``
    work-items each. Too few of them leave multiprocessors and schedulers without work.
    """
    warps = max(1.0, groups * max(1.0, group / LANES))
    processors = min(float(card.multiprocessors), max(1.0, groups))
    schedulers = min(processors * card.schedulers, warps)
    special = schedulers * card.special_lanes / card.schedulers
    wavefronts = sums["local_wavefronts"] + sums["global_wavefronts"]
    sectors = sums["group_sectors_read"] + sums["global_sectors_written"]
    compulsory = sums["compulsory_read"] + sums["compulsory_written"]
    operations = processors * card.fp32_lanes * 2
    limits = {
        "issue": sums["warp_instructions"] / schedulers / card.clock,
        "FP32": sums["lane_operations"] / operations / card.clock,
        "special functions": sums["warp_special"] * LANES / special / card.clock,
        "shared memory and L1": wavefronts / processors / card.clock,
        "L2": sectors * SECTOR / card.l2,
        "DRAM": compulsory / card.dram,
    }
    return Bound(
        {name: 1e6 * value for name, value in limits.items()}, 1e6 * launches * card.launch
    )


class Sum(Bound):
    """The bound of kernels that run one after the other, each at its own largest limit."""

    @property
    def time(self) -> float:
        """The estimate."""
        return sum(self.limits.values()) + self.launches


def total(bounds: Iterable[Bound]) -> Sum:
    """Add up kernels that run one after the other."""
    limits: dict[str, float] = {}
    launches = 0.0
    for one in bounds:
        name, value = max(one.limits.items(), key=lambda item: item[1])
        limits[name] = limits.get(name, 0.0) + value
        launches += one.launches
    return Sum(limits, launches)
