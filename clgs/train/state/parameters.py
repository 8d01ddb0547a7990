"""The trained parameters on the device, with all that goes with each of their rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError
from clgs.opencl.device import Device
from clgs.ops import adam, density
from clgs.ops.density import DeviceStatistics, Statistics
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import FIELDS, AnchorSet, take
from clgs.scene.mlps import Mlps

Moments = adam.Moments[npt.NDArray[np.float32]]

ANCHOR_GROUPS = tuple(name for name in FIELDS if name != "position")
"""Anchor tensors that Adam updates; positions have learning rate 0."""

NOTHING_LEFT = (
    "pruning left no anchors: nothing is opaque in any view; "
    "check the images and poses, or lower the learning rates"
)


@dataclass(frozen=True)
class Parameters:
    """Anchors and MLP weights on the device, their Adam moments, and the anchors' statistics.

    ``moments`` holds those of ANCHOR_GROUPS and of "weights", shaped like these tensors.
    ``statistics`` decide about growing and pruning. ``hidden`` anchors have a position of NaN and
    do not count any more; their rows are left out later.
    """

    scene: DeviceScene
    moments: dict[str, adam.DeviceMoments]
    statistics: DeviceStatistics
    hidden: int = 0

    @property
    def rows(self) -> int:
        """The number of rows, including those of hidden anchors."""
        return len(self.scene.anchors)

    @property
    def count(self) -> int:
        """The number of anchors."""
        return self.rows - self.hidden

    def download_anchors(self, device: Device) -> AnchorSet:
        """Copy the anchors that are not hidden to the host."""
        anchors = self.scene.anchors.map(device.download)
        return take(anchors, ~np.isnan(anchors.position[:, 0])) if self.hidden else anchors

    def download(self, device: Device) -> HostRows:
        """Copy everything that has a row per anchor to the host; no anchor may be hidden."""
        assert not self.hidden
        device.release_unused()
        return HostRows(
            anchors=self.scene.anchors.map(device.download),
            statistics=self.statistics.map(device.download),
            moments={name: self.moments[name].map(device.download) for name in ANCHOR_GROUPS},
        )

    def with_rows(self, device: Device, rows: HostRows) -> Parameters:
        """The parameters with these rows in place of theirs; the MLP arrays stay where they are."""
        statistics = rows.statistics.map(device.upload)
        moments = {name: rows.moments[name].map(device.upload) for name in ANCHOR_GROUPS}
        scene = replace(self.scene, anchors=rows.anchors.map(device.upload))
        return Parameters(scene, {**self.moments, **moments}, statistics)


@dataclass
class HostRows:
    """Everything that has a row per anchor, on the host: anchors, statistics and Adam moments.

    ``moments`` holds those of ANCHOR_GROUPS, shaped like these tensors.
    """

    anchors: AnchorSet
    statistics: Statistics[npt.NDArray[Any]]
    moments: dict[str, Moments]

    def keep(self, kept: npt.NDArray[np.bool_]) -> int:
        """Drop the rows where ``kept`` (A,) is false; return how many.

        Raises:
            ClgsError: nothing is left.
        """
        rows = np.flatnonzero(kept)
        if not len(rows):
            raise ClgsError(NOTHING_LEFT)
        if len(rows) < len(kept):
            self.anchors = self.anchors.map(lambda array: array.take(rows, axis=0))
            self.statistics = self.statistics.map(lambda array: array.take(rows, axis=0))
            self.moments = {
                name: moments.map(lambda array: array.take(rows, axis=0))
                for name, moments in self.moments.items()
            }
        return len(kept) - len(rows)


def new_parameters(device: Device, anchors: AnchorSet, mlps: Mlps) -> Parameters:
    """Upload parameters; their moments and statistics are zero."""
    scene = DeviceScene(anchors.map(device.upload), device.upload(mlps.flat))
    moments = {
        name: adam.zero_moments(device, array)
        for name, array in scene.items()
        if name != "position"
    }
    return Parameters(scene, moments, density.zeros(device, len(anchors)))
