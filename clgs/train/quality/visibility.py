"""How much of the pictures each anchor makes up.

A pixel is the sum over its Gaussians of weight times color, with the weight alpha T. So the
gradient of a picture's sum by a Gaussian's color is the sum of its weights over the pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.data.masks import Mask
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import EXACT_ROOM, DeviceScene, Frame, upload_view
from clgs.render.rasterise import blend_backward, rasterise, with_enough_room
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings

LEAST_WEIGHT = 0.3
"""Pixels that an anchor must make up of a picture that shows it. Small shares add up: on fox what
makes up less than one pixel of every training photo is worth 0.3 dB of the held-out ones."""

Weights = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Visibility:
    """What the pictures of some cameras show of A anchors.

    views (A,) int64: how many pictures show the anchor, see LEAST_WEIGHT. weight, inside (A,)
    float64: sums of weights in pixels over the pictures that have a mask, of all their pixels and
    of those that the mask uses.
    """

    views: npt.NDArray[np.int64]
    weight: Weights
    inside: Weights


def visibility(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    options: RenderOptions = DEFAULT,
    on_render: Callable[[], None] = lambda: None,
) -> Visibility:
    """Draw the scene for each camera and sum the weights of every anchor.

    ``masks``: (H, W) uint8 of 0 and 1 per camera, None if there is none. ``on_render`` is called
    after each camera.

    Raises:
        BudgetError: the memory of ``options`` is too small for a picture.
    """
    count = len(scene.anchors)
    views, weight, inside = np.zeros(count, np.int64), np.zeros(count), np.zeros(count)
    found = view_weights(device, scene, settings, cameras, masks, options)
    for mask, (whole, part) in zip(masks, found, strict=True):
        views += whole >= LEAST_WEIGHT
        if mask is not None:
            weight += whole
            inside += part
        on_render()
    return Visibility(views, weight, inside)


def view_weights(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    options: RenderOptions = DEFAULT,
) -> Iterator[tuple[Weights, Weights]]:
    """The weights (A,) of all anchors per camera: over all pixels, and over those of its mask.

    The arguments are those of :func:`visibility`; without a mask the second weights are 0.

    Raises:
        BudgetError: as there.
    """
    room = EXACT_ROOM
    for camera, mask in zip(cameras, masks, strict=True):
        view = upload_view(device, camera, settings)
        draw = partial(rasterise, device, scene, view, options)
        frame, room = with_enough_room(device, room, draw)
        used = np.zeros((camera.height, camera.width)) if mask is None else mask
        weights = _frame_weights(device, frame, used.astype(np.float32), len(scene.anchors))
        del frame  # before the next one is made
        yield weights


def _frame_weights(
    device: Device, frame: Frame, used: npt.NDArray[np.float32], count: int
) -> tuple[Weights, Weights]:
    """The weights of ``count`` anchors in a picture, over all pixels and over ``used`` (H, W)."""
    one = np.ones_like(used)
    picked = device.upload(np.stack([one, used, np.zeros_like(used)]))
    by_gaussian = device.download(blend_backward(device, frame, picked).d_color)[:, :2]
    first = device.download(frame.gaussians.first)
    visible = device.download(frame.activations.visible)
    sums = np.zeros((len(by_gaussian) + 1, 2))
    np.cumsum(by_gaussian, axis=0, dtype=np.float64, out=sums[1:])
    ends = np.minimum(first, len(by_gaussian))
    weights, shown = np.zeros((count, 2)), visible >= 0
    weights[visible[shown]] = (sums[ends[1:]] - sums[ends[:-1]])[shown]
    return weights[:, 0], weights[:, 1]
