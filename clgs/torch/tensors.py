"""Tensors of the CPU as arrays of a device, and back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops.general import views
from clgs.options import RenderOptions
from clgs.render import channel_picture
from clgs.render.splat_arguments import SplatArguments


@dataclass
class Call:
    """What the functions of one call share; pictures count batches first.

    rows: of what is drawn among all Gaussians of all pictures, with packed arrays; centres: the
    tensor of ``meta``, which receives absolute gradients.
    """

    device: Device
    given: SplatArguments
    lens: views.Lens
    size: tuple[int, int]
    with_depth: bool
    alpha_max: float
    options: RenderOptions
    absgrad: bool
    splats: list[views.Splats] = field(default_factory=list)
    cameras: list[DeviceArray] = field(default_factory=list)
    drawn: list[channel_picture.Drawn] = field(default_factory=list)
    rows: Tensor | None = None
    centres: Any = None

    def pictures(self) -> list[tuple[int, int]]:
        """Batch and camera of every picture."""
        return list(np.ndindex(self.given.viewmats.shape[:2]))


def checked(name: str, tensor: Any) -> npt.NDArray[Any] | None:
    """The tensor's memory as an array; TypeError or ValueError if it is none of the CPU's."""
    if tensor is None:
        return None
    if not isinstance(tensor, Tensor):
        raise TypeError(f"{name}: is {type(tensor).__name__}; give a tensor")
    if tensor.device.type != "cpu":
        raise ValueError(f"{name}: is on {tensor.device}; tensors lie on the CPU: .cpu()")
    return host_of(tensor)


def host_of(tensor: Tensor) -> npt.NDArray[Any]:
    """The tensor's memory as a contiguous array."""
    return np.ascontiguousarray(tensor.detach().numpy())


def stacked(arrays: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """All as one array; no copy of a single one."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def gathered(
    device: Device, arrays: list[DeviceArray], sizes: tuple[int, ...], width: int | None
) -> Tensor:
    """A tensor (*sizes, width) of arrays of the device that nothing writes to any more."""
    shape = sizes if width is None else (*sizes, width)
    if not arrays:
        return torch.zeros(shape)
    return torch.from_numpy(stacked([device.hand_over(one) for one in arrays])).reshape(shape)


def packed_rows(call: Call, every: Tensor) -> Tensor:
    """The rows that are drawn, of (B, C, N, ...); all if arrays are not packed."""
    return every if call.rows is None else every.reshape(-1, *every.shape[3:])[call.rows]


def unpacked_rows(call: Call, some: Tensor, sizes: torch.Size) -> Tensor:
    """The mirror of packed_rows, of (..., 2); zeros elsewhere."""
    if call.rows is None:
        return some.reshape(*sizes, 2)
    every = np.zeros((sizes.numel(), 2), np.float32)
    every[call.rows.numpy()] = host_of(some)
    return torch.from_numpy(every).reshape(*sizes, 2)
