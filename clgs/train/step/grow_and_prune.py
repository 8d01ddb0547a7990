"""Growing and pruning of anchors where they are, on the device.

Statistics are summed up at every step. At the end of some steps, :func:`replace_anchors` prunes and
grows: slots ask for anchors, and some of the cells get one. Rows that stay are not moved, new ones
come last, and anchors that go are hidden until :func:`compacted` leaves out their rows.
Source: Scaffold-GS, section 3.3; Voxel-GS adds the mask prune (section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, LOG_SCALE_LIMIT
from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import density, growth
from clgs.ops.growth import NewAnchors
from clgs.render.frame import Frame, SceneGradients
from clgs.train.config import TrainConfig
from clgs.train.config.size_settings import GROWTH_THRESHOLD, LEAST_THRESHOLD
from clgs.train.state.run_state import ANCHOR_GROUPS, NOTHING_LEFT, HostRows, Parameters
from clgs.train.state.voxel_grid import Floats, VoxelWindow, cells_of, occur, voxels_of

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
    2^i times the :func:`threshold` ask, with probability 1 - 0.5^(i+1), for an anchor at their
    position rounded to cells of ``growth_cell`` // 4^i voxels. Cells that hold no anchor get one,
    with log(cell edge) as scalings; those that asked are its parents. Levels with cells below a
    voxel are skipped, and those after a first level that added nothing. Cells outside the box, if
    one is given, and more than 2^20 voxels from the middle of the anchors are not served, and none
    once there are ``most_anchors``: the first slots to ask are then those with the largest
    gradient.

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
    least = threshold(config, occupied.shape[1], mean)
    voxels, children, parents = [occupied], [], []
    edges: list[npt.NDArray[np.float64]] = []
    for level in range(config.growth_levels):
        factor, count = config.growth_cell // CELL_DIVISOR**level, sum(len(edge) for edge in edges)
        if factor == 0 or (level > 0 and not count):
            break
        asking = np.flatnonzero(mean >= least * THRESHOLD_FACTOR**level)
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


def threshold(config: TrainConfig, anchors: int, mean: npt.NDArray[np.float64]) -> float:
    """The mean gradient from which slots ask at level 0, if there are that many ``anchors``.

    If a size is asked for that holds more, it is the gradient that as many slots reach as anchors
    are missing, between LEAST_THRESHOLD and GROWTH_THRESHOLD; else GROWTH_THRESHOLD.
    """
    if config.growth_threshold is not None:
        return config.growth_threshold
    room = min(config.held_anchors, config.most_anchors) - anchors
    missing = min(room, len(mean))
    if missing <= 0:
        return GROWTH_THRESHOLD
    last = float(np.partition(mean, -missing)[-missing])
    return min(max(last, LEAST_THRESHOLD), GROWTH_THRESHOLD)


NEARLY = 1.0 - 1e-5
"""A slightly lower threshold, so that a comparison in float32 misses no slot that asks."""

Positions = npt.NDArray[np.float32]
"""A copy of the positions (A, 3) on the host, NaN for hidden anchors."""


def observes(config: TrainConfig, step: int) -> bool:
    """Whether statistics are taken in step number ``step``."""
    return config.statistics_start < step < config.growth_end


def seen_view(frame: Frame, gradients: SceneGradients) -> density.SeenView:
    """What the statistics take of a rendered view."""
    return density.SeenView(
        output=frame.activations.output.first(K_OFFSETS),
        visible=frame.activations.visible,
        slot=frame.gaussians.slot,
        extent=frame.projected.extent,
        d_mean2d=gradients.d_mean2d,
        size=frame.view.size,
    )


def replaces_anchors(config: TrainConfig, step: int) -> bool:
    """Whether the anchors change at the end of step number ``step``."""
    in_window = max(config.statistics_start, config.growth_start) < step < config.growth_end
    return in_window and step % max(1, config.growth_interval // config.batch) == 0


def replace_anchors(
    device: Device,
    config: TrainConfig,
    parameters: Parameters,
    frame: Frame,
    rng: np.random.Generator,
) -> Parameters:
    """Prune and grow after a step that rendered ``frame``; anchors that go are hidden.

    Raises:
        ClgsError: no anchor is left.
    """
    visible = frame.activations.visible
    if (box := config.learning_box) is not None:
        outside = ~box.holds(device.download(parameters.scene.anchors.position))
        parameters, visible = without(device, parameters, visible, outside)
    position = mask_prune(device, parameters, visible, frame.activations.output)
    parameters, position = grow(device, config, parameters, position, rng)
    prune(device, config, parameters, position)
    return replace(parameters, hidden=count_hidden(position))


def without(
    device: Device,
    parameters: Parameters,
    visible: DeviceArray,
    outside: npt.NDArray[np.bool_],
) -> tuple[Parameters, DeviceArray]:
    """The parameters and the visible anchors (V,) as if the anchors ``outside`` were never seen.

    Their statistics become 0, so that they neither go nor ask for others.
    """
    seen = device.download(visible)
    seen[(seen >= 0) & outside[seen]] = -1

    def forget(array: DeviceArray) -> DeviceArray:
        values = device.download(array)
        values[outside] = 0
        return device.upload(values)

    forgotten = replace(parameters, statistics=parameters.statistics.map(forget))
    return forgotten, device.upload(seen)


def count_hidden(position: Positions) -> int:
    """The number of hidden anchors.

    Raises:
        ClgsError: all are hidden.
    """
    hidden = int(np.isnan(position[:, 0]).sum())
    if hidden == len(position):
        raise ClgsError(NOTHING_LEFT)
    return hidden


def mask_prune(
    device: Device, parameters: Parameters, visible: DeviceArray, output: DeviceArray
) -> Positions:
    """Hide anchors that a view sees without drawing anything of them; return the positions.

    Offsets of slots that are not drawn are set to 0 in the visible anchors that stay. Anchors and
    statistics are changed in place.

    ``visible`` and ``output`` as for :func:`clgs.ops.growth.hide_undrawn`.

    Raises:
        ClgsError: no anchor is left.
    """
    anchors = parameters.scene.anchors
    growth.hide_undrawn(device, anchors, parameters.statistics, visible, output)
    position = device.download(anchors.position)
    count_hidden(position)
    return position


def grow(
    device: Device,
    config: TrainConfig,
    parameters: Parameters,
    position: Positions,
    rng: np.random.Generator,
) -> tuple[Parameters, Positions]:
    """Add the anchors of :func:`clgs.train.step.grow_and_prune.wanted_anchors`, after the others.

    Their offsets, moments and statistics are 0, their features the maximum of their parents'.
    Sums of slots seen more than ``slot_seen`` times are then zeroed.
    """
    statistics, anchors = parameters.statistics, parameters.scene.anchors
    least = LEAST_THRESHOLD if config.growth_threshold is None else config.growth_threshold
    slots = growth.asking(device, statistics, config.slot_seen, NEARLY * least)
    with device.mapped(statistics.gradient_sum, statistics.gradient_count) as sums:
        mean = sums[0].ravel()[slots] / sums[1].ravel()[slots]
    growth.restart(device, statistics, config.slot_seen)
    places = partial(growth.places, device, anchors)
    new = wanted_anchors(position, slots, mean, places, config, rng)
    if not len(new):
        return parameters, position
    zeros = partial(growth.with_zeros, device, rows=len(new))
    held = [*anchors.items(), *statistics.items()]  # moments are as the anchors
    if not all(device.has_room(array, len(array) + len(new)) for _, array in held):
        device.release_unused()  # longer arrays come next
    scene = replace(parameters.scene, anchors=growth.append(device, anchors, new))
    moments = {name: parameters.moments[name].map(zeros) for name in ANCHOR_GROUPS}
    grown = Parameters(
        scene, parameters.moments | moments, statistics.map(zeros), parameters.hidden
    )
    return grown, np.concatenate([position, new.position])


def prune(device: Device, config: TrainConfig, parameters: Parameters, position: Positions) -> int:
    """Hide anchors that stayed transparent, also in ``position``; return how many.

    Of the anchors visited more than ``anchor_visits`` times, those with a summed opacity below
    ``prune_opacity`` per visit go, and the sums of the others are zeroed. Scaling [3:6] of all that
    stay is capped at ``scaling_cap``, unless only the anchors of a box learn.

    Raises:
        ClgsError: no anchor is left.
    """
    # a cap would change anchors outside of a box, too
    cap = float(np.finfo(np.float32).max) if config.box else config.scaling_cap
    limits = config.anchor_visits, config.prune_opacity, cap
    rows = growth.prune(device, parameters.scene.anchors, parameters.statistics, *limits)
    position[rows] = np.nan
    count_hidden(position)
    return len(rows)


def compacted(device: Device, parameters: Parameters) -> Parameters:
    """The parameters without the rows of hidden anchors; those of the others keep their order."""
    if not parameters.hidden:
        return parameters
    device.release_unused()
    live = ~np.isnan(device.download(parameters.scene.anchors.position)[:, 0])
    rows = device.upload(np.flatnonzero(live).astype(np.int32))
    take = partial(growth.take, device, rows=rows)
    scene = replace(parameters.scene, anchors=parameters.scene.anchors.map(take))
    moments = {name: parameters.moments[name].map(take) for name in ANCHOR_GROUPS}
    return Parameters(scene, parameters.moments | moments, parameters.statistics.map(take))


def merge_cells(rows: HostRows, q_position: float) -> int:
    """Move anchors to the grid of ``q_position`` cells per scene unit; return how many merged away.

    Of the anchors of a cell the one with the largest summed opacity stays, with its moments; the
    first one in case of a tie. Positions become float32(integer / q_position).

    Raises:
        ClgsError: the grid is too fine for the extent of the anchors.
    """
    cells = voxels_of(rows.anchors.position, q_position)
    keys = VoxelWindow.around(cells).keys(cells)
    order = np.lexsort((-rows.statistics.opacity_sum, keys))
    first = np.ones(len(order), np.bool_)
    first[1:] = keys[order[1:]] != keys[order[:-1]]
    keep = np.zeros(len(order), np.bool_)
    keep[order[first]] = True
    merged = rows.keep(keep)
    position = (cells[:, keep].T / np.float64(q_position)).astype(np.float32)
    rows.anchors = replace(rows.anchors, position=position)
    return merged
