"""What cameras see of a scene's neural Gaussians, and how much each contributes to the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS
from clgs.opencl.device import Device
from clgs.options import RenderOptions
from clgs.render.frame import DeviceScene, DeviceView, Frame
from clgs.render.pipeline import blend_backward, view_forward

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Observation:
    """M neural Gaussians that contribute to one picture.

    slot (M,) int64: anchor times K plus number of the offset, each at most once; weight (M,):
    sum over the pixels of alpha times transmittance, in pixels; direction (M, 3): unit, from the
    camera; mean (M, 3), scale (M, 3), rotation (M, 4), color (M, 3), opacity (M,) as in
    ``clgs.ops.neural.Gaussians``. Float32.
    """

    slot: npt.NDArray[np.int64]
    weight: Array
    direction: Array
    mean: Array
    scale: Array
    rotation: Array
    color: Array
    opacity: Array


def observe(
    device: Device, scene: DeviceScene, view: DeviceView, options: RenderOptions
) -> Observation:
    """Draw one view of ``scene``.

    The picture is linear in the colors: its derivative by one of them is what that Gaussian
    contributes.
    """
    frame = view_forward(device, scene, view, options)
    ones = device.upload(np.ones(frame.image.shape, np.float32))
    weight = device.download(blend_backward(device, frame, ones).d_color)[:, 0]
    seen = np.flatnonzero(weight > 0)
    mean, scale, rotation, color, opacity = (
        device.download(getattr(frame.gaussians, name))[seen]
        for name in ("mean", "scale", "rotation", "color", "opacity")
    )
    centre = device.download(view.camera)[-3:]
    offset = mean - centre
    direction = offset / np.linalg.norm(offset, axis=1, keepdims=True)
    slot = _scene_slots(device, frame)[seen]
    return Observation(slot, weight[seen], direction, mean, scale, rotation, color, opacity)


def _scene_slots(device: Device, frame: Frame) -> npt.NDArray[np.int64]:
    """Anchor of the scene times K plus number of the offset, for every Gaussian of a frame."""
    visible = device.download(frame.activations.visible).astype(np.int64)
    slot = device.download(frame.gaussians.slot)
    return np.asarray(visible[slot // K_OFFSETS] * K_OFFSETS + slot % K_OFFSETS)
