"""Growing and pruning of anchors, and merging them on a coarser grid, on host arrays.

Within a step: statistics, :func:`mask_prune`, :func:`grow`, :func:`prune`. Each of them changes
the state that it is given; rows keep their order and new rows come last. An anchor is identified
by the integer coordinates of its voxel. Source: Scaffold-GS, section 3.3; Voxel-GS adds the mask
prune (section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, LOG_SCALE_LIMIT
from clgs.errors import ClgsError
from clgs.ops.density import Statistics
from clgs.scene.anchors import AnchorSet, concatenate
from clgs.train.config import TrainConfig
from clgs.train.density.initial_anchors import GRID_BITS
from clgs.train.state.parameters import Moments

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

CELL_DIVISOR = 4
"""A level's cells have this fraction of the edge of those of the level before it."""

THRESHOLD_FACTOR = 2.0
"""A level's gradient threshold over that of the level before it."""


@dataclass
class TrainState:
    """Everything that has a row per anchor: anchors, statistics and Adam's moments.

    moments: of ``parameters.ANCHOR_GROUPS``, shaped as those are.
    """

    anchors: AnchorSet
    statistics: Statistics[npt.NDArray[Any]]
    moments: dict[str, Moments]


@dataclass(frozen=True)
class _Grid:
    """Window of 2^21 voxels per axis around the anchors; inside it keys are unique."""

    low: Integers

    @classmethod
    def around(cls, integers: Integers) -> _Grid:
        low, high = integers.min(axis=0), integers.max(axis=0)
        if not (high - low < 1 << GRID_BITS).all():
            raise ClgsError(
                f"anchors: extent is {int((high - low).max())} grid cells, must be below "
                f"2^{GRID_BITS}; use a larger voxel or a smaller Q_P"
            )
        return cls((low + high) // 2 - ((1 << (GRID_BITS - 1)) - 1))

    def holds(self, coordinates: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Which of the voxel coordinates (n, 3) lie in the window; NaN does not."""
        inside = (coordinates >= self.low) & (coordinates < self.low + (1 << GRID_BITS))
        return np.asarray(inside.all(axis=1))

    def keys(self, cells: Integers, factor: int = 1) -> Integers:
        """(n,) keys of cells (n, 3) of ``factor`` voxels, each the rounded voxel / ``factor``."""
        x, y, z = (cells - _cells_of(self.low, factor)).T
        return np.asarray((x << 2 * GRID_BITS) | (y << GRID_BITS) | z)


def position_integers(position: Floats, q_position: float) -> Integers:
    """Grid coordinates (A, 3) int64 of positions float32(integer / q_position), exactly."""
    return np.rint(position.astype(np.float64) * q_position).astype(np.int64)


def mask_prune(state: TrainState, visible: npt.NDArray[np.int32], opacity: Floats) -> int:
    """Remove anchors that a view sees without drawing anything of them; returns how many.

    Offsets of slots that are not drawn are set to 0 in the visible anchors that stay.

    Args:
        state: changed; row numbers such as ``visible`` are void afterwards.
        visible: (V,) distinct rows of the anchors visible in this step's view.
        opacity: (V, K) their decoded opacities; a slot is drawn if it is above 0.

    Raises:
        ClgsError: no anchor is left.
    """
    drawn = opacity > 0.0
    rows, slots = np.nonzero(~drawn)
    state.anchors.offset[visible[rows], slots] = 0.0
    keep = np.ones(len(state.anchors), np.bool_)
    keep[visible] = drawn.any(axis=1)
    return keep_rows(state, keep)


def grow(state: TrainState, config: TrainConfig, rng: np.random.Generator) -> int:
    """Add anchors at slots with a large screen gradient; returns how many.

    At level i, slots seen more than ``slot_seen`` times with a mean gradient of at least
    ``growth_threshold`` * 2^i ask, with probability 1 - 0.5^(i+1), for an anchor at their position
    rounded to cells of ``growth_cell`` // 4^i voxels. Cells that hold no anchor get one: offsets
    and moments zero, feature the channel-wise maximum of the asking anchors' features, scaling
    log(cell edge). Levels with cells below a voxel are skipped, and those after a first level
    that added nothing. Accumulators of slots seen more than ``slot_seen`` times are then zeroed.
    Cells more than 2^20 voxels from the middle of the anchors are not served, and none once there
    are ``max_anchors``: the first slots to ask are then those with the largest gradient.
    """
    statistics, room = state.statistics, _room(len(state.anchors), config)
    seen = statistics.gradient_count > config.slot_seen
    mean = np.where(seen, statistics.gradient_sum, -1.0) / np.maximum(statistics.gradient_count, 1)
    added: list[AnchorSet] = []
    occupied = position_integers(state.anchors.position, 1.0 / config.voxel)
    grid = _Grid.around(occupied)
    for level in range(config.growth_levels):
        factor = config.growth_cell // CELL_DIVISOR**level
        if factor == 0 or (level > 0 and not added):
            break
        asking = np.flatnonzero(mean >= config.growth_threshold * THRESHOLD_FACTOR**level)
        asking = asking[rng.random(len(asking)) > 0.5 ** (level + 1)]
        asking = _largest(mean.ravel(), asking, room - sum(map(len, added)))
        cells, features = _new_cells(state.anchors, asking, occupied, grid, (factor, config.voxel))
        if len(cells):
            occupied = np.concatenate([occupied, cells * factor])
            added.append(_new_anchors(cells * factor, features, factor, config.voxel))
    statistics.gradient_sum[seen] = 0.0
    statistics.gradient_count[seen] = 0
    _append(state, added)
    return sum(map(len, added))


def prune(state: TrainState, config: TrainConfig) -> int:
    """Remove anchors that stayed transparent; returns how many.

    Of the anchors visited more than ``anchor_visits`` times, those with a summed opacity below
    ``prune_opacity`` per visit go, and the sums of the others are zeroed. Scaling [3:6] of all that
    stay is capped at ``scaling_cap``.

    Raises:
        ClgsError: no anchor is left.
    """
    statistics = state.statistics
    visited = statistics.visits > config.anchor_visits
    least = np.float32(config.prune_opacity) * statistics.visits.astype(np.float32)
    opaque = statistics.opacity_sum >= least
    statistics.opacity_sum[visited] = 0.0
    statistics.visits[visited] = 0
    removed = keep_rows(state, ~visited | opaque)
    shape = state.anchors.scaling[:, 3:]
    np.minimum(shape, np.float32(config.scaling_cap), out=shape)
    return removed


def merge_cells(state: TrainState, q_position: float) -> int:
    """Move anchors to the grid of ``q_position`` cells a scene unit; returns how many merged away.

    Of the anchors of a cell the one with the largest summed opacity stays, with its moments; the
    first one in case of a tie. Positions become float32(integer / q_position).

    Raises:
        ClgsError: the grid is too fine for the extent of the anchors.
    """
    cells = position_integers(state.anchors.position, q_position)
    keys = _Grid.around(cells).keys(cells)
    order = np.lexsort((-state.statistics.opacity_sum, keys))
    first = np.ones(len(order), np.bool_)
    first[1:] = keys[order[1:]] != keys[order[:-1]]
    keep = np.zeros(len(order), np.bool_)
    keep[order[first]] = True
    merged = keep_rows(state, keep)
    position = (cells[keep] / np.float64(q_position)).astype(np.float32)
    state.anchors = replace(state.anchors, position=position)
    return merged


def _room(anchors: int, config: TrainConfig) -> int:
    """How many anchors may be added."""
    return max(0, config.max_anchors - anchors) if config.max_anchors else 1 << 62


def _largest(
    mean: npt.NDArray[np.floating], asking: npt.NDArray[np.intp], room: int
) -> npt.NDArray[np.intp]:
    """At most ``room`` of the slots ``asking``, those with the largest ``mean``, ascending."""
    if len(asking) <= room:
        return asking
    return np.sort(asking[np.argsort(-mean[asking], kind="stable")[:room]])


def _cells_of(integers: Integers, factor: int) -> Integers:
    """Cell coordinates of voxels: the nearest cell centre, halves to the even one."""
    return np.rint(integers / factor).astype(np.int64)


def _new_cells(
    anchors: AnchorSet,
    asking: npt.NDArray[np.intp],
    occupied: Integers,
    grid: _Grid,
    cell: tuple[int, float],
) -> tuple[Integers, Floats]:
    """Unoccupied cells (n, 3) that the slots ``asking`` lie in, ascending; features (n, F)."""
    factor, voxel = cell
    rows, slots = np.divmod(asking, K_OFFSETS)
    wanted = np.rint(_slot_coordinates(anchors, rows, slots, occupied, voxel) / factor)
    inside = grid.holds(wanted * factor)
    wanted, rows = wanted[inside].astype(np.int64), rows[inside]
    keys = grid.keys(wanted, factor)
    taken = np.sort(grid.keys(_cells_of(occupied, factor), factor))
    free = np.flatnonzero(~_is_in(keys, taken))
    order = free[np.argsort(keys[free], kind="stable")]
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    if not len(first):
        return np.empty((0, 3), np.int64), np.empty((0, anchors.feature.shape[1]), np.float32)
    features = np.maximum.reduceat(anchors.feature[rows[order]], first, axis=0)
    return wanted[order[first]], features


def _is_in(keys: Integers, ascending: Integers) -> npt.NDArray[np.bool_]:
    """Which keys occur among others; by bisection, several times faster than numpy.isin."""
    place = np.minimum(np.searchsorted(ascending, keys), len(ascending) - 1)
    return np.asarray(ascending[place] == keys)


def _slot_coordinates(
    anchors: AnchorSet,
    rows: npt.NDArray[np.intp],
    slots: npt.NDArray[np.intp],
    integers: Integers,
    voxel: float,
) -> npt.NDArray[np.float64]:
    """P + O exp(S[:3]) in voxels, (n, 3); from the integers, so offset 0 is the anchor's voxel."""
    log_scale = np.clip(anchors.scaling[rows, :3], -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT)
    shift = anchors.offset[rows, slots] * np.exp(log_scale.astype(np.float64))
    return np.asarray(integers[rows] + shift / voxel)


def _new_anchors(integers: Integers, feature: Floats, factor: int, voxel: float) -> AnchorSet:
    count = len(integers)
    return AnchorSet(
        position=(integers / np.float64(1.0 / voxel)).astype(np.float32),
        offset=np.zeros((count, K_OFFSETS, 3), np.float32),
        feature=feature,
        scaling=np.full((count, 6), np.log(voxel * factor), np.float32),
    )


def keep_rows(state: TrainState, keep: npt.NDArray[np.bool_]) -> int:
    """Drop the other rows of the whole state; returns how many.

    Raises:
        ClgsError: nothing is left.
    """
    rows = np.flatnonzero(keep)
    if not len(rows):
        raise ClgsError(
            "pruning left no anchors: nothing is opaque in any view; "
            "check the images and poses, or lower the learning rates"
        )
    if len(rows) < len(keep):
        state.anchors = state.anchors.map(lambda array: array.take(rows, axis=0))
        _replace_records(state, lambda array: array.take(rows, axis=0))
    return len(keep) - len(rows)


def _append(state: TrainState, added: list[AnchorSet]) -> None:
    """Add rows to the anchors, and rows of zeros to the statistics and moments."""
    count = sum(map(len, added))
    if not count:
        return
    state.anchors = concatenate([state.anchors, *added])
    _replace_records(state, lambda array: _with_zeros(array, count))


def _with_zeros(array: npt.NDArray[Any], count: int) -> npt.NDArray[Any]:
    longer = np.empty((len(array) + count, *array.shape[1:]), array.dtype)
    longer[: len(array)] = array
    longer[len(array) :] = 0
    return longer


def _replace_records(
    state: TrainState, change: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
) -> None:
    """Apply ``change`` to every array of the statistics and moments, one at a time."""
    state.statistics = state.statistics.map(change)
    state.moments = {name: moments.map(change) for name, moments in state.moments.items()}
