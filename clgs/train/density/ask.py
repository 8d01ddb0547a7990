"""Where slots ask for anchors, and which cells get one. Source: Scaffold-GS, section 3.3."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, LOG_SCALE_LIMIT
from clgs.ops.growth import NewAnchors
from clgs.train.config import TrainConfig
from clgs.train.density.voxel_grid import Floats, VoxelWindow, cells_of, occur, voxels_of

CELL_DIVISOR = 4
"""A level's cells have this fraction of the edge of those of the level before it."""

THRESHOLD_FACTOR = 2.0
"""A level's gradient threshold over that of the level before it."""

Rows = npt.NDArray[np.intp]

Places = Callable[[Rows], Floats]
"""A function of slots (n,): their (n, 6) offsets and the log scales that multiply these."""


def wanted_anchors(
    position: Floats,
    slots: Rows,
    mean: npt.NDArray[np.float64],
    places: Places,
    config: TrainConfig,
    rng: np.random.Generator,
) -> NewAnchors:
    """Anchors to add at slots with a large screen gradient.

    At level i, slots seen more than ``slot_seen`` times with a mean gradient of at least
    ``growth_threshold`` * 2^i ask, with probability 1 - 0.5^(i+1), for an anchor at their position
    rounded to cells of ``growth_cell`` // 4^i voxels. Cells that hold no anchor get one, with
    log(cell edge) as scalings; those that asked are its parents. Levels with cells below a voxel
    are skipped, and those after a first level that added nothing. Cells outside the box, if one is
    given, and more than 2^20 voxels from
    the middle of the anchors are not served, and none once there are ``most_anchors``: the first
    slots to ask are then those with the largest gradient.

    Args:
        position: (A, 3); NaN for anchors that are hidden, whose slots must not ask.
        slots: (n,) anchor * K + offset, ascending: all that may ask, of those seen often enough.
        mean: (n,) their mean gradients.
        places: where slots are.
        config: of the run.
        rng: what the probabilities are drawn from.

    Raises:
        ClgsError: the anchors are too far apart.
    """
    occupied = np.compress(~np.isnan(position[:, 0]), voxels_of(position, 1.0 / config.voxel), 1)
    window, box = VoxelWindow.around(occupied), config.learning_box
    most = config.most_anchors
    room = max(0, most - occupied.shape[1]) if most else 1 << 62
    voxels, children, parents = [occupied], [], []
    edges: list[npt.NDArray[np.float64]] = []
    for level in range(config.growth_levels):
        factor, count = config.growth_cell // CELL_DIVISOR**level, sum(len(edge) for edge in edges)
        if factor == 0 or (level > 0 and not count):
            break
        asking = np.flatnonzero(mean >= config.growth_threshold * THRESHOLD_FACTOR**level)
        asking = asking[rng.random(len(asking)) > 0.5 ** (level + 1)]
        if len(asking) > (left := room - count):  # those with the largest gradient stay
            asking = np.sort(asking[np.argsort(-mean[asking], kind="stable")[:left]])
        if not len(asking):
            continue
        asked = slots[asking]
        place = places(asked).T
        # P + O exp(S[:3]) in voxels; from the integers, so that offset 0 is the anchor's voxel
        log_scale = np.clip(place[3:], -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT)
        shift = place[:3] * np.exp(log_scale.astype(np.float64))
        own = voxels_of(position[asked // K_OFFSETS], 1.0 / config.voxel)
        wanted = np.rint((own + shift / config.voxel) / factor)
        served = window.holds(wanted * factor)
        if box is not None:
            served &= box.holds(wanted.T * (factor * config.voxel))
        inside = np.flatnonzero(served)
        keys = window.keys(np.take(wanted, inside, axis=1), factor)
        order = np.argsort(keys, kind="stable")
        keys, inside = keys[order], inside[order]
        starts = np.flatnonzero(np.diff(keys, prepend=-1))
        free = np.ones(len(starts), np.bool_)
        for held in voxels:
            free &= ~occur(keys[starts], window.keys(cells_of(held, factor), factor))
        sizes = np.diff(starts, append=len(keys))
        voxels.append(np.take(wanted, inside[starts[free]], axis=1) * factor)
        edges.append(np.full(int(free.sum()), np.log(config.voxel * factor)))
        children.append(sizes[free])
        parents.append(asked[inside[np.repeat(free, sizes)]] // K_OFFSETS)
    new = np.concatenate([np.empty((3, 0)), *voxels[1:]], axis=1).T
    first = np.concatenate([[0], *children]).cumsum()
    return NewAnchors(
        position=(new / np.float64(1.0 / config.voxel)).astype(np.float32, order="C"),
        edge=np.concatenate([np.empty(0), *edges]).astype(np.float32),
        first=first.astype(np.int32),
        parents=np.concatenate([np.empty(0, np.int32), *parents]).astype(np.int32),
    )
