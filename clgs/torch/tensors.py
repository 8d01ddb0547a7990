"""Tensors of the CPU as arrays of a device, and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops.general import views
from clgs.ops.general.channels import ChannelGradients
from clgs.ops.project import Projected
from clgs.ops.tiles import TileLists
from clgs.options import RenderOptions
from clgs.render import channel_picture
from clgs.render.splat_arguments import Floats, SplatArguments

Given = ParamSpec("Given")
Result = TypeVar("Result")


@dataclass
class ViewsCall:
    """What the projection of one call shares; pictures count batches first.

    packed: whether centres are those of what is drawn alone. The forward pass fills the rest, also
    for the backward pass: splats of each batch; cameras and projected Gaussians of each picture;
    extents (B, C, N, 2) pixels, 0 if culled; rows of what is drawn among all Gaussians of all
    pictures; centres of all (B, C, N, 2); whether cameras have gradients. The
    backward pass of the blending begins that of the projection, as long as nobody needs another.
    """

    device: Device
    given: SplatArguments
    lens: views.CameraModel
    size: tuple[int, int]
    options: RenderOptions
    packed: bool
    splats: list[views.Splats] = field(default_factory=list)
    projected: list[Projected] = field(default_factory=list)
    cameras: list[DeviceArray] = field(default_factory=list)
    extents: Floats = field(default_factory=lambda: np.empty(0, np.float32))
    rows: npt.NDArray[np.int64] | None = None
    centres: Floats = field(default_factory=lambda: np.empty(0, np.float32))
    want_camera: bool = False
    begun: views.SplatGradients | None = None
    _passed: list[tuple[Tensor, int] | None] = field(default_factory=list)

    def backward(self, batch: int, at: int, given: ChannelGradients) -> views.SplatGradients:
        """Gradients by the Gaussians and the camera of a picture, from those by its screen."""
        splats, camera, seen = self.splats[batch], self.cameras[at], self.projected[at]
        with self.device.stage("views backward"):
            return views.backward(
                self.device, splats, camera, self.lens, seen, given, self.want_camera
            )

    def expect(self, begun: views.SplatGradients, tensors: list[Tensor | None]) -> None:
        """Keep what was begun from ``tensors``, which autograd passes on unless others add."""
        self.begun = begun
        # kept alive, so that no other tensor takes their memory
        self._passed = [None if one is None else (one, one._version) for one in tensors]

    def take_begun(self, tensors: tuple[Tensor | None, ...]) -> views.SplatGradients | None:
        """What was begun, if these are the tensors that it was begun from, unchanged."""
        begun, self.begun, passed, self._passed = self.begun, None, self._passed, []
        pairs = zip(tensors, passed or [None] * len(tensors), strict=True)
        return begun if all(_unchanged(one, kept) for one, kept in pairs) else None

    @cached_property
    def radii(self) -> npt.NDArray[np.int32]:
        """Half sizes of the boxes (B, C, N, 2), pixels, rounded up."""
        return np.ceil(self.extents).astype(np.int32)  # PyTorch's threads would wait


@dataclass
class BlendCall:
    """What the blending of one call shares; pictures count batches first.

    colors (B, 1 or C, N, D) and backgrounds (B, C, X); pictures: the axes of the results before
    their rows; seen: the projection, if it is of the same call; lists: the tile lists of every
    picture, if they are given; centres: the tensor that receives absolute gradients.
    """

    device: Device
    size: tuple[int, int]
    options: RenderOptions
    with_depth: bool
    alpha_max: float
    absgrad: bool
    backgrounds: Floats
    pictures: tuple[int, ...]
    colors: Floats = field(default_factory=lambda: np.empty(0, np.float32))
    seen: ViewsCall | None = None
    lists: list[TileLists] | None = None
    drawn: list[channel_picture.Drawn] = field(default_factory=list)
    centres: Any = None

    def draw(self, batch: int, number: int, projected: Projected) -> None:
        """Begin to draw the next picture; the colors of ``projected`` are not read."""
        own = self.colors[batch, number % self.colors.shape[1]]
        colored = replace(projected, color=self.device.share(own))
        shade = self.device.share(self.backgrounds[batch, number])
        lists = None if self.lists is None else self.lists[len(self.drawn)]
        how = self.with_depth, self.alpha_max, self.options, lists
        self.drawn.append(channel_picture.draw(self.device, colored, self.size, shade, *how))


def eager(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """``function``, which torch.compile calls as it is, between two of its graphs."""
    found: Callable[Given, Result] = torch._disable_dynamo(function)
    return found


def checked(name: str, tensor: Any) -> npt.NDArray[Any] | None:
    """The tensor's memory as an array.

    Raises:
        NotImplementedError: a transform of torch.func stands between.
        TypeError, ValueError: it is no tensor of the CPU.
    """
    if tensor is None:
        return None
    if not isinstance(tensor, Tensor):
        raise TypeError(f"{name}: is {type(tensor).__name__}; give a tensor")
    if not tensor.is_cpu:
        raise ValueError(f"{name}: is on {tensor.device}; tensors lie on the CPU: .cpu()")
    if torch._C._functorch.is_functorch_wrapped_tensor(tensor):
        raise NotImplementedError(
            f"{name}: torch.func's transforms are not offered; use torch.autograd.grad"
        )
    try:
        return host_of(tensor)
    except (TypeError, RuntimeError) as error:
        what = f"{tensor.dtype}, {tensor.layout}, shape {tuple(tensor.shape)}"
        remedy = "give a dense float32 tensor"
        raise TypeError(f"{name}: {what}: NumPy cannot read it; {remedy}: {error}") from None


def needed(name: str, tensor: Any) -> Tensor:
    """The tensor; TypeError or ValueError if it is none of the CPU's."""
    if checked(name, tensor) is None:
        raise TypeError(f"{name}: is None; give a tensor")
    found: Tensor = tensor
    return found


def check_shapes(
    expected: dict[str, tuple[Tensor | None, tuple[int, ...], torch.dtype | None]],
) -> None:
    """TypeError or ValueError unless tensors, by name, have their shapes and dtypes, if any."""
    for name, (tensor, shape, dtype) in expected.items():
        checked(name, tensor)
        if tensor is None:
            continue
        if tensor.shape != shape:
            raise ValueError(f"{name}: shape is {tuple(tensor.shape)}, expected {shape}")
        if dtype is not None and tensor.dtype != dtype:
            raise TypeError(f"{name}: dtype is {tensor.dtype}, expected {dtype}")


def host_of(tensor: Tensor) -> npt.NDArray[Any]:
    """The tensor's memory as a contiguous array."""
    return np.ascontiguousarray(tensor.numpy(force=True))  # neither gradients nor lazy signs


def tensor_like(array: npt.NDArray[Any], other: Tensor) -> Tensor:
    """The array's memory as a tensor of the shape of another."""
    found: Tensor = torch.from_numpy(array.reshape(other.shape))
    return found


def stacked(arrays: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """All as one array; no copy of a single one."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def gather_later(
    device: Device, found: Sequence[object], names: dict[str, int | None], sizes: tuple[int, ...]
) -> Callable[[], dict[str, Floats]]:
    """Fields of the records of all pictures, arrays of the device that nothing writes to any more.

    ``names``: of the fields, and the length of their last axis, if they have one after ``sizes``.
    The result waits, and not for later work of the device.
    """
    finish = device.hand_over_later([getattr(one, name) for name in names for one in found])

    def wait() -> dict[str, Floats]:
        hosts, result = iter(finish()), {}
        for name, width in names.items():
            shape = sizes if width is None else (*sizes, width)
            own = [next(hosts) for _ in found]
            result[name] = stacked(own).reshape(shape) if own else np.zeros(shape, np.float32)
        return result

    return wait


def _unchanged(tensor: Tensor | None, kept: tuple[Tensor, int] | None) -> bool:
    """Whether ``tensor`` is the one kept, and was not changed in place since its version was."""
    if tensor is None or kept is None:
        return tensor is kept
    same: bool = tensor.data_ptr() == kept[0].data_ptr() and tensor._version == kept[1]
    return same


def packed_rows(rows: npt.NDArray[np.int64] | None, every: Floats) -> Floats:
    """The rows that are drawn, of (B, C, N, 2); all if arrays are not packed."""
    if rows is None:
        return every
    pairs = every.reshape(-1, 2).view(np.int64)  # two floats as one number move faster
    return pairs.take(rows, axis=0).view(np.float32)


def unpacked_rows(
    rows: npt.NDArray[np.int64] | None, some: Floats, sizes: tuple[int, ...]
) -> Floats:
    """The mirror of packed_rows, of (..., 2); zeros elsewhere."""
    if rows is None:
        return some.reshape(*sizes, 2)
    every = np.zeros(int(np.prod(sizes)), np.int64)
    every[rows] = np.ascontiguousarray(some).view(np.int64)[:, 0]
    return every.view(np.float32).reshape(*sizes, 2)


def tensor_rows(rows: npt.NDArray[np.int64] | None, every: Tensor) -> Tensor:
    """The rows that are drawn, as of packed_rows, with a gradient."""
    if rows is None:
        return every
    return every.reshape(-1, *every.shape[3:]).index_select(0, torch.from_numpy(rows))
