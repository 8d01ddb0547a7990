"""Decide when anchors grow and are pruned, and move them between device and host for it."""

from __future__ import annotations

import numpy as np

from clgs.constants import K_OFFSETS
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import density as density_op
from clgs.render.frame import Frame, SceneGradients
from clgs.train.config import TrainConfig
from clgs.train.density.grow_and_prune import (
    Statistics,
    TrainState,
    grow,
    mask_prune,
    merge_cells,
    prune,
)
from clgs.train.state.parameters import Parameters, download_anchors, upload_anchors


class Densifier:
    """Accumulates statistics on the device; every interval grows and prunes on the host."""

    def __init__(self, device: Device, config: TrainConfig, count: int) -> None:
        """Start with zero statistics for ``count`` anchors."""
        self._device, self._config = device, config
        self.statistics = self._upload(zero_statistics(count))

    def observe(
        self, frame: Frame, gradients: SceneGradients, step: int, stop: DeviceArray
    ) -> None:
        """Add step number ``step`` to the statistics where they are taken and ``stop`` is 0."""
        config = self._config
        if not config.statistics_start < step < config.growth_end:
            return
        seen = density_op.ScreenGradients(
            frame.gaussians.slot, frame.projected.extent, gradients.d_mean2d, *frame.size
        )
        output, visible = frame.activations.output, frame.activations.visible
        density_op.accumulate(self._device, self.statistics, output, visible, seen, stop)

    def replaces_anchors(self, step: int) -> bool:
        """Whether the anchors change at the end of step number ``step``."""
        config = self._config
        in_window = max(config.statistics_start, config.growth_start) < step < config.growth_end
        return in_window and step % config.growth_interval == 0

    def align(self, parameters: Parameters, q_position: float) -> tuple[Parameters, int]:
        """Anchors moved to the grid of 1/Q_P, those of one cell merged, and how many merged.

        A no-op where the grid is that of the voxels, as it is by default.
        """
        anchors, moments = download_anchors(self._device, parameters)
        state = TrainState(anchors, self.download(), moments)
        merged = merge_cells(state, q_position)
        return self._replace(parameters, state), merged

    def replace_anchors(
        self, parameters: Parameters, frame: Frame, rng: np.random.Generator
    ) -> Parameters:
        """Prune and grow after a step that rendered ``frame``."""
        device = self._device
        anchors, moments = download_anchors(device, parameters)
        state = TrainState(anchors, self.download(), moments)
        visible = device.download(frame.activations.visible)
        columns = np.flatnonzero(visible >= 0)
        opacity = device.download(frame.activations.output)[:K_OFFSETS, columns].T
        mask_prune(state, visible[columns], opacity)
        grow(state, self._config, rng)
        prune(state, self._config)
        return self._replace(parameters, state)

    def _replace(self, parameters: Parameters, state: TrainState) -> Parameters:
        self.statistics = self._upload(state.statistics)
        scene = parameters.scene
        return upload_anchors(
            self._device,
            state.anchors,
            state.moments,
            scene.weights,
            parameters.moments["weights"],
        )

    def download(self) -> Statistics:
        """Host copy of the statistics."""
        arrays = self.statistics
        return Statistics(
            *(
                self._device.download(array)
                for array in (
                    arrays.opacity_sum,
                    arrays.visits,
                    arrays.gradient_sum,
                    arrays.gradient_count,
                )
            )
        )

    def restore(self, statistics: Statistics) -> None:
        """Continue from saved statistics."""
        self.statistics = self._upload(statistics)

    def _upload(self, statistics: Statistics) -> density_op.Statistics:
        return density_op.Statistics(
            self._device.upload(statistics.opacity_sum),
            self._device.upload(statistics.visits),
            self._device.upload(statistics.gradient_sum),
            self._device.upload(statistics.gradient_count),
        )


def zero_statistics(count: int) -> Statistics:
    """Statistics of ``count`` anchors that nothing has seen yet."""
    return Statistics(
        np.zeros(count, np.float32),
        np.zeros(count, np.int32),
        np.zeros((count, K_OFFSETS), np.float32),
        np.zeros((count, K_OFFSETS), np.int32),
    )
