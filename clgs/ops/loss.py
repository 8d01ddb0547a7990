"""The image loss and the volume term (Voxel-GS; Scaffold-GS).

    value = l1_weight * mean |x - y| + ssim_weight * (1 - SSIM)
    SSIM = mean over pixels and channels of
           (2 mu_x mu_y + C1)(2 cov_xy + C2) / ((mu_x^2 + mu_y^2 + C1)(var_x + var_y + C2))

with moments under an 11 x 11 Gaussian window of sigma 1.5 and zero padding (Wang et al. 2004). The
kernel takes the moments of centred pixels, patch by patch, and writes the maps that the backward
pass blurs once more; kernels_cl/loss/forward.cl has the equations. The derivative of |x| at 0 is 0.

The volume term is the mean over Gaussians of the product of their scales (Scaffold-GS).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clgs import constants
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_lanes
from clgs.opencl.transfer import Download
from clgs.shapes import Shapes

PATCH_COLUMNS = 16
PATCH_ROWS = 32
"""Taller patches blur fewer rows twice, but need more memory."""

ITEMS = {"cpu": 1, "gpu": 256}
"""Work-items of a group, which owns a patch or a block."""


@dataclass(frozen=True)
class Weights:
    """Factors of the L1 term and of 1 - SSIM."""

    l1: float = 0.8
    ssim: float = 0.2


@dataclass(frozen=True)
class LossValue:
    """Mean absolute error, SSIM and their weighted sum; not finite if the image is not."""

    l1: float
    ssim: float
    value: float


@dataclass(frozen=True)
class Loss:
    """What the forward pass leaves on the device, float32.

    sums (patches, 2): those of |x - y| and of 1 - SSIM; shift (patches, 2): the level about which
    the moments of image and target were taken; maps: three of (3, H, W), see
    kernels_cl/loss/forward.cl.
    """

    sums: DeviceArray
    weights: Weights
    shift: DeviceArray
    maps: tuple[DeviceArray, DeviceArray, DeviceArray]

    def value(self, device: Device) -> LossValue:
        """Download the sums and add them up; waits for the device."""
        return self.value_later(device).get()

    def value_later(self, device: Device) -> LaterValue:
        """Begin :meth:`value`; only ``LaterValue.get`` waits."""
        return LaterValue(device.download_later(self.sums), self.maps[0].size, self.weights)


@dataclass(frozen=True)
class LaterValue:
    """The value of a loss of ``count`` numbers, the download of whose sums is pending.

    They are added in float64 and in order: the same bits in every run.
    """

    sums: Download
    count: int
    weights: Weights

    def get(self) -> LossValue:
        """The value; waits for it."""
        l1, lost = (self.sums.get().sum(axis=0, dtype=np.float64) / max(self.count, 1)).tolist()
        return LossValue(l1, 1.0 - lost, self.weights.l1 * l1 + self.weights.ssim * lost)


def forward(
    device: Device, image: DeviceArray, target: DeviceArray, weights: Weights | None = None
) -> Loss:
    """Compare an image (3, H, W) float32 with a photo (3, H, W) uint8, of which 255 is 1.0.

    ``weights``: of the two terms; default 0.8 and 0.2.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    height, width = _check(image, target)
    across, down = _patches(height, width)
    sums = device.empty((3 * across * down, 2))
    shift = device.empty((3 * across * down, 2))
    maps = (device.empty(image.shape), device.empty(image.shape), device.empty(image.shape))
    items = ITEMS[device.specialisation]
    device.run(
        device.kernel("loss/forward", "loss_forward", **_defines(device)),
        (across * items, down, 3),
        (items, 1, 1),
        image=image,
        target=target,
        width=np.int32(width),
        height=np.int32(height),
        shifts=shift,
        r_map=maps[0],
        v_map=maps[1],
        w_map=maps[2],
        sums=sums,
    )
    return Loss(sums, weights or Weights(), shift, maps)


def backward(device: Device, image: DeviceArray, target: DeviceArray, loss: Loss) -> DeviceArray:
    """d_image (3, H, W) float32, the gradient of the value of ``loss``.

    ``image`` and ``target`` are those that :func:`forward` made ``loss`` of.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    height, width = _check(image, target)
    across, down = _patches(height, width)
    d_image = device.empty(image.shape)
    count = max(3 * height * width, 1)
    items = ITEMS[device.specialisation]
    device.run(
        device.kernel("loss/backward", "loss_backward", **_defines(device)),
        (across * items, down, 3),
        (items, 1, 1),
        image=image,
        target=target,
        width=np.int32(width),
        height=np.int32(height),
        shifts=loss.shift,
        r_map=loss.maps[0],
        v_map=loss.maps[1],
        w_map=loss.maps[2],
        l1_scale=_factor(loss.weights.l1, count),
        ssim_scale=_factor(-loss.weights.ssim, count),
        d_image=d_image,
    )
    return d_image


def volume(
    device: Device,
    scale: DeviceArray,
    weight: float,
    d_scale: DeviceArray,
    total: DeviceArray | None = None,
) -> None:
    """Add to ``d_scale`` the gradient of ``weight`` times the mean product of the scales.

    Args:
        device: where the arrays live.
        scale: (N, 3) float32, scene units.
        weight: factor of the term in the loss.
        d_scale: (N, 3) float32, changed in place.
        total: (1,) int64, how many of the N there are; the others have scale 0. Default: all.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("scale", scale, "N 3", np.float32)
    shapes.check("d_scale", d_scale, "N 3", np.float32)
    count = shapes.axes["N"]
    if total is None:
        total = device.upload(np.array([count], np.int64))
    device.run(
        device.kernel("loss/volume", "loss_volume"),
        *by_lanes(device, count, device.vec),
        scale=scale,
        count=np.int32(count),
        weight=_factor(weight, 1),
        total=total,
        d_scale=d_scale,
    )


def _factor(weight: float, count: int) -> np.float32:
    """weight / count; infinite if it exceeds float32, and then so is the gradient."""
    with np.errstate(over="ignore"):
        return np.float32(weight / count)


def _check(image: DeviceArray, target: DeviceArray) -> tuple[int, int]:
    shapes = Shapes()
    shapes.check("image", image, "3 H W", np.float32)
    shapes.check("target", target, "3 H W", np.uint8)
    return shapes.axes["H"], shapes.axes["W"]


def _patches(height: int, width: int) -> tuple[int, int]:
    return -(-width // PATCH_COLUMNS), -(-height // PATCH_ROWS)


def _defines(device: Device) -> dict[str, Any]:
    taps = [
        math.exp(-0.5 * (tap / constants.SSIM_SIGMA) ** 2)
        for tap in range(constants.SSIM_WINDOW // 2 + 1)
    ]
    total = taps[0] + 2 * sum(taps[1:])
    weights = {f"SSIM_WEIGHT_{tap}": weight / total for tap, weight in enumerate(taps)}
    levels = {"SSIM_C1": constants.SSIM_C1, "SSIM_C2": constants.SSIM_C2}
    sizes = {"PATCH_ROWS": PATCH_ROWS, "PATCH_COLUMNS": PATCH_COLUMNS}
    return {**sizes, "ITEMS": ITEMS[device.specialisation], **weights, **levels}
