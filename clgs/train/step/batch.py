"""What the looks of a step leave, added up on the device that has the state of the run."""

from __future__ import annotations

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import batch
from clgs.ops.density import SeenView
from clgs.ops.loss import LaterValue
from clgs.render.frame import SceneGradients
from clgs.train.state.parameters import ANCHOR_GROUPS
from clgs.train.step.look import Look


class Batch:
    """The looks of a step, in the order of its views.

    losses, totals, partials and seen: of each, as of :class:`Look`; seen has those that statistics
    take; kept: the looks that were had on other devices.
    """

    def __init__(self, device: Device, views: int) -> None:
        """Nothing of ``views`` looks yet."""
        self._device, self._views = device, views
        self._gradients: SceneGradients | None = None
        self.losses: list[LaterValue] = []
        self.totals: list[Download] = []
        self.partials: list[DeviceArray] = []
        self.seen: list[SeenView] = []
        self.kept: list[Look] = []

    @property
    def gradients(self) -> SceneGradients:
        """The mean of the gradients, once all looks are added; d_projected is the first one's."""
        assert self._gradients is not None
        return self._gradients

    def add(self, look: Look) -> None:
        """Add the next look, whose arrays are on the device or shared with it."""
        self.losses.append(look.loss)
        self.totals.append(look.totals)
        self.partials.append(look.partials)
        if look.seen is not None:
            self.seen.append(look.seen)
        if look.frame is None:
            self.kept.append(look)
        if self._gradients is None:
            self._gradients = look.gradients
            return
        scale = 1 / self._views if len(self.losses) == self._views else 1.0
        with self._device.stage("batch"):
            for name in (*ANCHOR_GROUPS, "weights"):
                total = getattr(self._gradients, f"d_{name}")
                batch.add(self._device, total, getattr(look.gradients, f"d_{name}"), scale)
