"""Exposure of photos: an affine map of colors between a render and the loss, one for each photo.

    picture = M image + b,    map = (M | b), 3 x 4, at first the identity (1 | 0)

The loss compares the picture with the photo; a penalty, weight * |map - identity|^2, holds what the
photos leave open, and :func:`centre` what all of them have in common, which is the scene's. The
affine map for each photo is that of the reference code of 3DGS ("exposure"), which has neither.
"""

from __future__ import annotations

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items
from clgs.opencl.kernel import Kernel
from clgs.ops.loss import ITEMS
from clgs.shapes import Shapes

MAP_SIZE = 12
EXPOSURE_BLOCK = 2048
"""Pixels that a work-group sums."""


def identity(device: Device, photos: int) -> DeviceArray:
    """Maps (photos, 3, 4) float32 that change nothing."""
    return device.upload(np.tile(np.eye(3, 4, dtype=np.float32), (photos, 1, 1)))


def forward(device: Device, image: DeviceArray, maps: DeviceArray, photo: int) -> DeviceArray:
    """The image (3, H, W) float32 as row ``photo`` of ``maps`` (P, 3, 4) float32 exposes it.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype, or there is no such photo.
    """
    total = _check(image, maps, photo)
    picture = device.empty(image.shape)
    device.run(
        _kernel(device, "exposure_forward"),
        *by_items(-(-total // device.vec)),
        image=image,
        total=np.uint32(total),
        maps=maps,
        photo=np.uint32(photo),
        picture=picture,
    )
    return picture


def backward(
    device: Device,
    image: DeviceArray,
    d_picture: DeviceArray,
    maps: DeviceArray,
    photo: int,
    weight: float,
    d_maps: DeviceArray,
) -> DeviceArray:
    """d_image (3, H, W) float32; the gradient of one photo's map goes into ``d_maps``.

    ``image``, ``maps`` and ``photo`` as for :func:`forward`; ``d_picture`` (3, H, W) float32: the
    gradient by what it returned; ``weight``: of the penalty. Row ``photo`` of ``d_maps`` (P, 3, 4)
    float32 is overwritten, the others stay.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype, or there is no such photo.
    """
    total = _check(image, maps, photo)
    shapes = Shapes(H=image.shape[1], W=image.shape[2], P=len(maps))
    shapes.check("d_picture", d_picture, "3 H W", np.float32)
    shapes.check("d_maps", d_maps, "P 3 4", np.float32)
    blocks, items = -(-total // EXPOSURE_BLOCK), ITEMS[device.specialisation]
    d_image, sums = device.empty(image.shape), device.empty((blocks, MAP_SIZE))
    device.run(
        _kernel(device, "exposure_backward"),
        (blocks * items,),
        (items,),
        image=image,
        d_picture=d_picture,
        total=np.uint32(total),
        maps=maps,
        photo=np.uint32(photo),
        d_image=d_image,
        sums=sums,
    )
    device.run(
        _kernel(device, "exposure_sum"),
        (MAP_SIZE,),
        None,
        sums=sums,
        blocks=np.uint32(blocks),
        maps=maps,
        photo=np.uint32(photo),
        pull=np.float32(2 * weight),
        d_maps=d_maps,
    )
    return d_image


def centre(device: Device, maps: DeviceArray, stop: DeviceArray) -> None:
    """Move all ``maps`` (P, 3, 4) float32 alike, so that their mean is the identity.

    ``stop`` (1,) int32: unless it holds 0 nothing changes.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    Shapes().check("maps", maps, "P 3 4", np.float32)
    kernel = _kernel(device, "exposure_centre")
    device.run(kernel, (MAP_SIZE,), None, maps=maps, photos=np.uint32(len(maps)), stop=stop)


def _kernel(device: Device, name: str) -> Kernel:
    return device.kernel(
        "loss/exposure",
        name,
        ITEMS=ITEMS[device.specialisation],
        EXPOSURE_BLOCK=EXPOSURE_BLOCK,
        MAP_SIZE=MAP_SIZE,
    )


def _check(image: DeviceArray, maps: DeviceArray, photo: int) -> int:
    """The number of pixels."""
    shapes = Shapes()
    shapes.check("image", image, "3 H W", np.float32)
    shapes.check("maps", maps, "P 3 4", np.float32)
    if not 0 <= photo < len(maps):
        raise ValueError(f"photo: {photo}, there are {len(maps)}")
    return shapes.axes["H"] * shapes.axes["W"]
