"""Decide when anchors grow and are pruned, and move them between device and host for rounds."""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import density as density_op
from clgs.render.frame import Frame, SceneGradients
from clgs.train.config import TrainConfig
from clgs.train.density.grow_and_prune import DeviceState, compact, grow, mask_prune, prune
from clgs.train.density.host_state import TrainState, merge_cells
from clgs.train.state.parameters import Parameters


class Densifier:
    """Accumulates statistics on the device; every interval grows and prunes there."""

    def __init__(self, device: Device, config: TrainConfig, count: int) -> None:
        """Start with zero statistics for ``count`` anchors."""
        self._device, self._config = device, config
        self.statistics = density_op.zeros(device, count)

    def observe(
        self, frame: Frame, gradients: SceneGradients, step: int, stop: DeviceArray
    ) -> None:
        """Add step number ``step`` to the statistics, if they are taken then and ``stop`` is 0."""
        config = self._config
        if not config.statistics_start < step < config.growth_end:
            return
        seen = density_op.SeenView(
            output=frame.activations.output,
            visible=frame.activations.visible,
            slot=frame.gaussians.slot,
            extent=frame.projected.extent,
            d_mean2d=gradients.d_mean2d,
            size=frame.view.size,
        )
        density_op.accumulate(self._device, self.statistics, seen, stop)

    def replaces_anchors(self, step: int) -> bool:
        """Whether the anchors change at the end of step number ``step``."""
        config = self._config
        in_window = max(config.statistics_start, config.growth_start) < step < config.growth_end
        return in_window and step % config.growth_interval == 0

    def align(self, parameters: Parameters, q_position: float) -> tuple[Parameters, int]:
        """Anchors moved to the grid of 1/Q_P, those of one cell merged, and how many merged.

        Nothing changes if the grid is that of the voxels, as it is by default.
        """
        state = self.download(parameters)
        merged = merge_cells(state, q_position)
        return self.replaced(parameters, state), merged

    def replace_anchors(
        self, parameters: Parameters, frame: Frame, rng: np.random.Generator
    ) -> Parameters:
        """Prune and grow after a step that rendered ``frame``; anchors that go are hidden."""
        device, config = self._device, self._config
        seen = frame.activations.visible, frame.activations.output
        state = mask_prune(device, parameters, self.statistics, *seen)
        grow(device, state, config, rng)
        prune(device, state, config)
        self.statistics = state.statistics
        return state.settled()

    def compacted(self, parameters: Parameters) -> Parameters:
        """The anchors that are not hidden, in the same order."""
        if not parameters.hidden:
            return parameters
        self._device.release_unused()
        state = DeviceState.of(self._device, parameters, self.statistics)
        compact(self._device, state)
        self.statistics = state.statistics
        return state.parameters

    def download(self, parameters: Parameters) -> TrainState:
        """Host copies of all that has a row per anchor; none may be hidden."""
        assert not parameters.hidden
        device = self._device
        device.release_unused()
        return TrainState(
            anchors=parameters.scene.anchors.map(device.download),
            statistics=self.statistics.map(device.download),
            moments=parameters.download_moments(device),
        )

    def replaced(self, parameters: Parameters, state: TrainState) -> Parameters:
        """The anchors of ``state``, with their statistics and moments, on the device."""
        self.statistics = state.statistics.map(self._device.upload)
        return parameters.with_anchors(self._device, state.anchors, state.moments)
