"""Sums that kernels leave on the device block by block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download


@dataclass(frozen=True)
class BlockSums:
    """Float32 sums (blocks, columns), one row per block, and the ``count`` of values in a column.

    The count may be on the device, (1,) of an integer type.

    Nothing waits for the device until :meth:`mean` is called, so that a step can enqueue all its
    work first. The blocks are added in float64 and in order: same bits in every run.
    """

    partials: DeviceArray
    count: int | DeviceArray

    def mean(self, device: Device) -> npt.NDArray[np.float64]:
        """(columns,) float64: the sum of every column divided by ``count``; 0 of nothing."""
        return self.mean_later(device).get()

    def mean_later(self, device: Device) -> LaterMean:
        """Begin :meth:`mean`; only ``LaterMean.get`` waits."""
        count = self.count
        later = count if isinstance(count, int) else device.download_later(count)
        return LaterMean(device.download_later(self.partials), later)


@dataclass(frozen=True)
class LaterMean:
    """The means of :class:`BlockSums`, on their way to the host."""

    partials: Download
    count: int | Download

    def get(self) -> npt.NDArray[np.float64]:
        """(columns,) float64; waits until they are there."""
        count = self.count if isinstance(self.count, int) else int(self.count.get()[0])
        total = self.partials.get().sum(axis=0, dtype=np.float64)
        return np.asarray(total / max(count, 1), np.float64)
