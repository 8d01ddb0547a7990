"""Where slots ask for anchors, and which cells get one. Source: Scaffold-GS, section 3.3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, LOG_SCALE_LIMIT
from clgs.ops.growth import NewAnchors
from clgs.train.config import TrainConfig
from clgs.train.density.voxel_grid import (
    Axes,
    Floats,
    VoxelWindow,
    cells_of,
    occur,
    voxels_of,
)

CELL_DIVISOR = 4
"""A level's cells have this fraction of the edge of those of the level before it."""

THRESHOLD_FACTOR = 2.0
"""A level's gradient threshold over that of the level before it."""

NEARLY = 1.0 - 1e-5

Rows = npt.NDArray[np.intp]

Places = Callable[[Rows], Floats]
"""A function of slots (n,): their (n, 6) offsets and the log scales that multiply these."""


@dataclass(frozen=True)
class StrongSlots:
    """Slots (n,), anchor * K + offset, ascending, and their mean gradients (n,) float64."""

    slots: Rows
    mean: npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Level:
    """Cells (3, n) of ``factor`` voxels that get an anchor, ascending, with their parents."""

    factor: int
    cells: Axes
    first: Rows
    parents: Rows


@dataclass
class _Found:
    """Voxels (3, A) that held an anchor before, their window, and the levels so far."""

    occupied: Axes
    window: VoxelWindow
    levels: list[_Level] = field(default_factory=list)

    @property
    def count(self) -> int:
        """How many anchors are new."""
        return sum(level.cells.shape[1] for level in self.levels)

    @property
    def voxels(self) -> list[Axes]:
        """All voxels that hold an anchor."""
        return [self.occupied, *(level.cells * level.factor for level in self.levels)]


def nearly(threshold: float) -> float:
    """A slightly lower threshold, so that a comparison in float32 misses no slot that asks."""
    return threshold * NEARLY


def strong_slots(
    slots: Rows,
    gradient_sum: npt.NDArray[np.float32],
    gradient_count: npt.NDArray[np.int32],
    config: TrainConfig,
) -> StrongSlots:
    """Select the ``slots`` that ask at level 0, by their sums and counts (n,)."""
    mean = gradient_sum / gradient_count
    strong = mean >= config.growth_threshold
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
    occupied = np.compress(live, voxels_of(position, 1.0 / config.voxel), axis=1)
    most = config.most_anchors
    room = max(0, most - occupied.shape[1]) if most else 1 << 62
    found = _Found(occupied, VoxelWindow.around(occupied))
    for level in range(config.growth_levels):
        factor = config.growth_cell // CELL_DIVISOR**level
        if factor == 0 or (level > 0 and not found.count):
            break
        asking = np.flatnonzero(mean >= config.growth_threshold * THRESHOLD_FACTOR**level)
        asking = asking[rng.random(len(asking)) > 0.5 ** (level + 1)]
        if len(asking) > (left := room - found.count):  # those with the largest gradient stay
            asking = np.sort(asking[np.argsort(-mean[asking], kind="stable")[:left]])
        if len(asking):
            coordinates = _coordinates(slots[asking], position, places, config.voxel)
            _add_level(found, factor, slots[asking] // K_OFFSETS, coordinates)
    return _new_anchors(found.levels, config.voxel)


def _coordinates(slots: Rows, position: Floats, places: Places, voxel: float) -> Axes:
    """P + O exp(S[:3]) in voxels, (3, n); from the integers, so offset 0 is the anchor's voxel."""
    place = places(slots).T
    voxels = voxels_of(position[slots // K_OFFSETS], 1.0 / voxel)
    log_scale = np.clip(place[3:], -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT)
    shift = place[:3] * np.exp(log_scale.astype(np.float64))
    return np.asarray(voxels + shift / voxel)


def _add_level(found: _Found, factor: int, rows: Rows, coordinates: Axes) -> None:
    """Give anchors to cells of ``factor`` voxels that hold none, at the coordinates (3, n)."""
    wanted = np.rint(coordinates / factor)
    inside = np.flatnonzero(found.window.holds(wanted * factor))
    keys = found.window.keys(np.take(wanted, inside, axis=1), factor)
    order = np.argsort(keys, kind="stable")
    keys, inside = keys[order], inside[order]
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    free = np.ones(len(starts), np.bool_)
    for voxels in found.voxels:
        free &= ~occur(keys[starts], found.window.keys(cells_of(voxels, factor), factor))
    if free.any():
        sizes = np.diff(starts, append=len(keys))
        parents = inside[np.repeat(free, sizes)]
        first = np.cumsum(sizes[free]) - sizes[free]
        found.levels.append(
            _Level(factor, np.take(wanted, parents[first], axis=1), first, rows[parents])
        )


def _new_anchors(levels: list[_Level], voxel: float) -> NewAnchors:
    """The anchors of all levels, one level after the other."""
    voxels = [(level.cells * level.factor).T for level in levels]
    edges = [np.full(len(level.first), np.log(voxel * level.factor)) for level in levels]
    before = np.cumsum([0, *(len(level.parents) for level in levels)])
    first = [level.first + start for level, start in zip(levels, before, strict=False)]
    return NewAnchors(
        position=(np.concatenate([np.empty((0, 3)), *voxels]) / np.float64(1.0 / voxel)).astype(
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
