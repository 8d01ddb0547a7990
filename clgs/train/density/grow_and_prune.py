"""Growing and pruning of anchors where they are, on the device.

Within a step: statistics, :func:`mask_prune`, :func:`grow`, :func:`prune`. Rows that stay are not
moved, new ones come last, and anchors that go are hidden until :func:`compact` leaves them out.
Source: Scaffold-GS, section 3.3; Voxel-GS adds the mask prune (section 3.2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import growth
from clgs.ops.density import DeviceStatistics
from clgs.train.config import TrainConfig
from clgs.train.density.ask import nearly, strong_slots, wanted_anchors
from clgs.train.density.host_state import NOTHING_LEFT
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters


@dataclass
class DeviceState:
    """All that has a row per anchor, on the device, and the positions on the host, too.

    position (A, 3) float32, NaN of those that are hidden.
    """

    parameters: Parameters
    statistics: DeviceStatistics
    position: npt.NDArray[np.float32]

    @classmethod
    def of(
        cls, device: Device, parameters: Parameters, statistics: DeviceStatistics
    ) -> DeviceState:
        """Waits for the device."""
        return cls(parameters, statistics, device.download(parameters.scene.anchors.position))

    @property
    def live(self) -> npt.NDArray[np.bool_]:
        """Which anchors (A,) are not hidden."""
        return ~np.isnan(self.position[:, 0])

    def settled(self) -> Parameters:
        """The parameters, which know how many anchors are hidden.

        Raises:
            ClgsError: all are.
        """
        hidden = len(self.position) - int(self.live.sum())
        if hidden == len(self.position):
            raise ClgsError(NOTHING_LEFT)
        return replace(self.parameters, hidden=hidden)


def mask_prune(
    device: Device,
    parameters: Parameters,
    statistics: DeviceStatistics,
    visible: DeviceArray,
    output: DeviceArray,
) -> DeviceState:
    """Hide anchors that a view sees without drawing anything of them.

    Offsets of slots that are not drawn are set to 0 in the visible anchors that stay. Anchors and
    statistics are changed in place.

    Args:
        device: where the arrays live.
        parameters: A anchors.
        statistics: of the same anchors.
        visible: (V,) int32, distinct rows of the anchors visible in this step's view; -1 is none.
        output: (at least K, Vp) float32, whose first K rows are opacities; a slot is drawn if its
            is above 0.

    Raises:
        ClgsError: no anchor is left.
    """
    growth.hide_undrawn(device, parameters.scene.anchors, statistics, visible, output)
    state = DeviceState.of(device, parameters, statistics)
    state.settled()
    return state


def grow(device: Device, state: DeviceState, config: TrainConfig, rng: np.random.Generator) -> int:
    """Add the anchors of :func:`clgs.train.density.ask.wanted_anchors`; returns how many.

    Offsets, moments and statistics of new ones are 0, features the maximum of their parents'.
    Sums of slots seen more than ``slot_seen`` times are then zeroed.
    """
    statistics, anchors = state.statistics, state.parameters.scene.anchors
    slots = growth.asking(device, statistics, config.slot_seen, nearly(config.growth_threshold))
    with device.mapped(statistics.gradient_sum, statistics.gradient_count) as sums:
        strong = strong_slots(slots, sums[0].ravel()[slots], sums[1].ravel()[slots], config)
    growth.restart(device, statistics, config.slot_seen)
    places = partial(growth.places, device, anchors)
    new = wanted_anchors(state.position, strong, places, config, rng)
    if len(new):
        _append(device, state, new)
    return len(new)


def _append(device: Device, state: DeviceState, new: growth.NewAnchors) -> None:
    before = state.parameters
    zeros = partial(growth.with_zeros, device, rows=len(new))
    held = [*before.scene.anchors.items(), *state.statistics.items()]  # moments are as the anchors
    if not all(device.has_room(array, len(array) + len(new)) for _, array in held):
        device.release_unused()  # longer arrays come next
    anchors = growth.append(device, before.scene.anchors, new)
    moments = {name: before.moments[name].map(zeros) for name in ANCHOR_GROUPS}
    state.parameters = Parameters(
        replace(before.scene, anchors=anchors), before.moments | moments, before.hidden
    )
    state.statistics = state.statistics.map(zeros)
    state.position = np.concatenate([state.position, new.position])


def prune(device: Device, state: DeviceState, config: TrainConfig) -> int:
    """Hide anchors that stayed transparent; returns how many.

    Of the anchors visited more than ``anchor_visits`` times, those with a summed opacity below
    ``prune_opacity`` per visit go, and the sums of the others are zeroed. Scaling [3:6] of all that
    stay is capped at ``scaling_cap``.

    Raises:
        ClgsError: no anchor is left.
    """
    statistics, anchors = state.statistics, state.parameters.scene.anchors
    limits = config.anchor_visits, config.prune_opacity, config.scaling_cap
    rows = growth.prune(device, anchors, statistics, *limits)
    state.position[rows] = np.nan
    state.settled()
    return len(rows)


def compact(device: Device, state: DeviceState) -> None:
    """Leave out the rows of hidden anchors; those of the others keep their order."""
    if not state.settled().hidden:
        return
    live, before = state.live, state.parameters
    rows = device.upload(np.flatnonzero(live).astype(np.int32))
    take = partial(growth.take, device, rows=rows)
    anchors = before.scene.anchors.map(take)
    moments = {name: before.moments[name].map(take) for name in ANCHOR_GROUPS}
    scene = replace(before.scene, anchors=anchors)
    state.parameters = Parameters(scene, before.moments | moments)
    state.statistics = state.statistics.map(take)
    state.position = state.position[live]
