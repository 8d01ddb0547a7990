"""Voxel-GS scenes from PyTorch: decoded anchors, straight-through rounding, the rate proxy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from clgs import constants
from clgs.arguments import check_type
from clgs.opencl.device import Device
from clgs.ops import quantize as quantize_op
from clgs.ops import rate as rate_op
from clgs.render.decoded_anchors import check_floats, decode
from clgs.render.rasterization import default_device
from clgs.scene.anchors import Anchors
from clgs.scene.camera import Camera
from clgs.torch.functions import once
from clgs.torch.tensors import checked, eager, host_of


class DecodedAnchors(NamedTuple):
    """N Gaussians; shapes and units are those of what :func:`clgs.decode_anchors` returns."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    anchor_ids: Tensor
    offset_ids: Tensor


@eager
def decode_anchors(
    position: Tensor,
    offset: Tensor,
    feature: Tensor,
    scaling: Tensor,
    weights: Tensor,
    camera: Camera,
    near: float = constants.NEAR_PLANE,
    device: Device | None = None,
) -> DecodedAnchors:
    """The neural Gaussians that ``camera`` sees of A anchors; see :func:`clgs.decode_anchors`.

    Gradients flow to offset, feature, scaling and weights. Positions are integers of the file,
    divided by a scale: they do not move and have no gradient, and neither has the camera.

    Args:
        position: (A, 3) float32, scene units.
        offset: (A, K, 3) float32, in units of exp(scaling[:, :3]).
        feature: (A, F) float32.
        scaling: (A, 6) float32, log of scene units.
        weights: (13710,) float32, packed as ``Mlps.flat``.
        camera: OpenCV's axes.
        near: smallest depth of an anchor that is seen, scene units; of a scene ``settings.near``.
        device: where it is computed; default a device that is opened once.

    Raises:
        TypeError: an argument is no tensor of float32, or ``camera`` no camera; names it.
        ValueError: a tensor has another shape, is not on the CPU, or holds a number that is not
            finite, or ``position`` asks for a gradient; names it and its shape.
    """
    check_type("camera", camera, Camera, "of a view give view.camera")
    tensors = {
        "position": position,
        "offset": offset,
        "feature": feature,
        "scaling": scaling,
        "weights": weights,
    }
    for name, tensor in tensors.items():
        _floats(name, tensor)
    if position.requires_grad:
        raise ValueError(
            f"position: {tuple(position.shape)} asks for a gradient; positions are fixed: .detach()"
        )
    found = Decode.apply(device or default_device(), camera, near, *tensors.values())
    return DecodedAnchors(*found)


@eager
def quantize(x: Tensor, q: float | Tensor) -> Tensor:
    """rint(x q) / q, ties to even, with the gradient of x (straight-through estimator).

    Args:
        x: float32, of any shape. The integers are those of a file if ``|x q| < 2^22``.
        q: integers per unit, above 0: a number, or float32 of the shape of ``x``.

    Raises:
        TypeError: an argument is no tensor of float32, or ``q`` no number; names it.
        ValueError: a tensor is not on the CPU or not finite, shapes differ, or ``q`` is not above
            0; names it.
    """
    _floats("x", x)
    if not isinstance(q, Tensor):
        _check_scale(q)
    elif q.shape != x.shape:
        raise ValueError(f"q: shape is {tuple(q.shape)}, expected {tuple(x.shape)}")
    elif not (_floats("q", q) > 0).all():
        raise ValueError(f"q: {tuple(q.shape)} has numbers that are not above 0")
    result: Tensor = Quantize.apply(x, q)
    return result


@eager
def rate(x: Tensor, q: float, form: rate_op.Form = "channel") -> Tensor:
    """Bits per row that an ideal coder needs for rint(x q): the Laplace rate proxy of Voxel-GS.

    The gradient flows through mean and scale, too, and passes the rounding unchanged.

    Args:
        x: (rows, ...) float32; every index after the first is a channel.
        q: integers per unit, above 0.
        form: "channel", a mean and scale for each, or "pooled", the form of the code of Voxel-GS.

    Returns:
        A scalar, float32.

    Raises:
        TypeError: ``x`` is no tensor of float32, or ``q`` no number; names it.
        ValueError: ``x`` is not on the CPU, not finite or a scalar, ``q`` is not above 0, or there
            is no such form.
    """
    _floats("x", x)
    if not x.ndim:
        raise ValueError("x: shape is (), expected (rows, ...)")
    _check_scale(q)
    result: Tensor = RateFunction.apply(x, q, form)
    return result


def _floats(name: str, tensor: Any) -> npt.NDArray[Any]:
    """The tensor's memory; TypeError or ValueError unless it is finite float32 of the CPU."""
    if tensor is None:
        raise TypeError(f"{name}: is None; give a tensor")
    host = checked(name, tensor)
    check_floats(name, host)
    assert host is not None
    return host


def _check_scale(q: Any) -> None:
    if isinstance(q, bool) or not isinstance(q, int | float | np.number):
        raise TypeError(f"q: is {type(q).__name__}; give a number")
    if not 0 < q < np.inf:
        raise ValueError(f"q: {q} is not a finite number above 0")


class Decode(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """Anchors and weights to the fields of :class:`DecodedAnchors`."""

    @staticmethod
    def forward(
        ctx: Any, device: Device, camera: Camera, near: float, *tensors: Tensor
    ) -> tuple[Tensor, ...]:
        """Decode ``tensors``: the four of the anchors, and the weights."""
        *anchors, weights = (host_of(one) for one in tensors)
        ctx.found = decode(device, Anchors(*anchors), weights, camera, near)
        ctx.save_for_backward(*tensors)  # the device reads them, and they must not have changed
        results = [torch.from_numpy(getattr(ctx.found, name)) for name in DecodedAnchors._fields]
        ctx.mark_non_differentiable(*results[5:])
        return tuple(results)

    @staticmethod
    @once
    def backward(ctx: Any, saved: tuple[Tensor, ...], *d: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients by offset, feature, scaling and weights."""
        made = ctx.found.backward(*(host_of(one) for one in d[:5]))
        names = "offset", "feature", "scaling", "weights"
        return None, None, None, None, *(torch.from_numpy(made[name]) for name in names)


class Quantize(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """rint(x q) / q; the gradient passes unchanged."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, q: float | Tensor) -> Tensor:
        """Round."""
        device = default_device()
        shared = device.share(host_of(x))
        if isinstance(q, Tensor):
            scales = device.share(host_of(q))
            rounded = quantize_op.elements(device, shared, scales)
        else:
            rounded = quantize_op.forward(device, [(shared, float(q))])[0]
        return torch.from_numpy(device.hand_over(rounded))

    @staticmethod
    def backward(ctx: Any, *d: Tensor) -> tuple[Tensor | None, ...]:
        """The straight-through estimator."""
        return d[0], None


class RateFunction(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """Bits per row of the symbols rint(x q)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, q: float, form: rate_op.Form) -> Tensor:
        """Count bits."""
        device = default_device()
        ctx.rate = rate_op.forward(device, device.share(host_of(x)), float(q), form)
        ctx.save_for_backward(x)
        return x.new_tensor(ctx.rate.bits)

    @staticmethod
    @once
    def backward(ctx: Any, saved: tuple[Tensor, ...], *d: Tensor) -> tuple[Tensor | None, ...]:
        """The gradient by x."""
        device, host = default_device(), host_of(saved[0])
        slopes = rate_op.slopes(device, ctx.rate, float(d[0]))
        shared, d_x = device.share(host), device.zeros(host.shape)
        rate_op.backward(device, [(slopes, shared, d_x)])
        return torch.from_numpy(device.hand_over(d_x)), None, None
