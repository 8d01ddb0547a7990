"""Where slots ask for anchors, and which cells get one. Source: Scaffold-GS, section 3.3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, LOG_SCALE_LIMIT
from clgs.ops.growth import NewAnchors
from clgs.train.config import TrainConfig
from clgs.train.density.cells import Floats, Grid, Integers, cells_of, position_integers

CELL_DIVISOR = 4
"""A level's cells have this fraction of the edge of those of the level before it."""

THRESHOLD_FACTOR = 2.0
"""A level's gradient threshold over that of the level before it."""

NEARLY = 1.0 - 1e-5
"""Times the threshold is what a first, quick look in float32 asks for."""

BLOCK = 1 << 15
"""Slots that are looked at together: what they take fits in a cache."""

Rows = npt.NDArray[np.intp]

Places = Callable[[Rows], Floats]
"""Of slots (n,): (n, 6) offsets, and the log scales that they are multiplied by."""


@dataclass(frozen=True)
class StrongSlots:
    """Slots (n,), anchor * K + offset, ascending, and their mean gradients (n,) float64."""

    slots: Rows
    mean: npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Level:
    """Cells (n, 3) of ``factor`` voxels that get an anchor, ascending, with their parents."""

    factor: int
    cells: Integers
    first: Rows
    parents: Rows


@dataclass
class _Found:
    """Voxels (n, 3) that hold an anchor, their window, and the levels so far."""

    occupied: Integers
    grid: Grid
    levels: list[_Level] = field(default_factory=list)

    @property
    def count(self) -> int:
        """How many anchors are new."""
        return sum(len(level.cells) for level in self.levels)


def strong_slots(
    gradient_sum: npt.NDArray[np.float32],
    gradient_count: npt.NDArray[np.int32],
    config: TrainConfig,
) -> StrongSlots:
    """The slots that ask at level 0, of sums of gradients and counts of views, (A, K) each."""
    sums, counts = gradient_sum.ravel(), gradient_count.ravel()
    threshold = config.growth_threshold
    found = [np.empty(0, np.intp)]
    for start in range(0, len(sums), BLOCK):
        part, count = sums[start : start + BLOCK], counts[start : start + BLOCK]
        least = np.float32(threshold * NEARLY) * count.astype(np.float32)
        found.append(start + np.flatnonzero((count > config.slot_seen) & (part >= least)))
    slots = np.concatenate(found)
    mean = sums[slots] / counts[slots]
    strong = mean >= threshold
    return StrongSlots(slots[strong], mean[strong])


def wanted_anchors(
    position: Floats,
    strong: StrongSlots,
    places: Places,
    config: TrainConfig,
    rng: np.random.Generator,
) -> NewAnchors:
    """Anchors to add at slots with a large screen gradient.

    At level i, slots seen more than ``slot_seen`` times with a mean gradient of at least
    ``growth_threshold`` * 2^i ask, with probability 1 - 0.5^(i+1), for an anchor at their position
    rounded to cells of ``growth_cell`` // 4^i voxels. Cells that hold no anchor get one, with
    log(cell edge) as scalings; those that asked are its parents. Levels with cells below a voxel
    are skipped, and those after a first level that added nothing. Cells more than 2^20 voxels from
    the middle of the anchors are not served, and none once there are ``most_anchors``: the first
    slots to ask are then those with the largest gradient.

    Args:
        position: (A, 3); NaN for anchors that are hidden, whose slots must not ask.
        strong: slots that ask at level 0.
        places: where slots are.
        config: of the run.
        rng: what the probabilities are drawn from.

    Raises:
        ClgsError: the anchors are too far apart.
    """
    slots, mean = strong.slots, strong.mean
    live = ~np.isnan(position[:, 0])
    occupied = position_integers(position if live.all() else position[live], 1.0 / config.voxel)
    most = config.most_anchors
    room = max(0, most - len(occupied)) if most else 1 << 62
    found = _Found(occupied, Grid.around(occupied))
    for level in range(config.growth_levels):
        factor = config.growth_cell // CELL_DIVISOR**level
        if factor == 0 or (level > 0 and not found.count):
            break
        asking = np.flatnonzero(mean >= config.growth_threshold * THRESHOLD_FACTOR**level)
        asking = asking[rng.random(len(asking)) > 0.5 ** (level + 1)]
        asking = slots[_largest(mean, asking, room - found.count)]
        if len(asking):
            coordinates = _coordinates(asking, position, places, config.voxel)
            _add_level(found, factor, asking // K_OFFSETS, coordinates)
    return _new_anchors(found.levels, config.voxel)


def _largest(mean: npt.NDArray[np.float64], asking: Rows, room: int) -> Rows:
    """At most ``room`` of those ``asking``, those with the largest ``mean``, ascending."""
    if len(asking) <= room:
        return asking
    return np.sort(asking[np.argsort(-mean[asking], kind="stable")[:room]])


def _coordinates(
    slots: Rows, position: Floats, places: Places, voxel: float
) -> npt.NDArray[np.float64]:
    """P + O exp(S[:3]) in voxels, (n, 3); from the integers, so offset 0 is the anchor's voxel."""
    place = places(slots)
    integers = position_integers(position[slots // K_OFFSETS], 1.0 / voxel)
    log_scale = np.clip(place[:, 3:], -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT)
    shift = place[:, :3] * np.exp(log_scale.astype(np.float64))
    return np.asarray(integers + shift / voxel)


def _add_level(
    found: _Found, factor: int, rows: Rows, coordinates: npt.NDArray[np.float64]
) -> None:
    """Give anchors to cells of ``factor`` voxels that hold none, at the coordinates (n, 3)."""
    wanted = np.rint(coordinates / factor)
    inside = found.grid.holds(wanted * factor)
    cells, rows = wanted[inside].astype(np.int64), rows[inside]
    keys = found.grid.keys(cells, factor)
    order = np.argsort(keys, kind="stable")
    taken = np.sort(found.grid.keys(cells_of(found.occupied, factor), factor))
    order = order[~_is_in(keys[order], taken)]
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    if len(first):
        level = _Level(factor, cells[order[first]], first, rows[order])
        found.levels.append(level)
        found.occupied = np.concatenate([found.occupied, level.cells * factor])


def _is_in(keys: Integers, ascending: Integers) -> npt.NDArray[np.bool_]:
    """Which keys occur among others; by bisection, several times faster than numpy.isin."""
    place = np.minimum(np.searchsorted(ascending, keys), len(ascending) - 1)
    return np.asarray(ascending[place] == keys)


def _new_anchors(levels: list[_Level], voxel: float) -> NewAnchors:
    """The anchors of all levels, one level after the other."""
    integers = [level.cells * level.factor for level in levels]
    edges = [np.full(len(level.cells), np.log(voxel * level.factor)) for level in levels]
    before = np.cumsum([0, *(len(level.parents) for level in levels)])
    first = [level.first + start for level, start in zip(levels, before, strict=False)]
    return NewAnchors(
        position=(np.concatenate([np.empty((0, 3)), *integers]) / np.float64(1.0 / voxel)).astype(
            np.float32
        ),
        edge=np.concatenate([np.empty(0), *edges]).astype(np.float32),
        first=np.append(np.concatenate([np.empty(0, np.int32), *first]), before[-1]).astype(
            np.int32
        ),
        parents=np.concatenate(
            [np.empty(0, np.int32), *(level.parents for level in levels)]
        ).astype(np.int32),
    )
