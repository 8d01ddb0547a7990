"""What changes of the anchors cost in terms of the loss, to second order.

The loss is proportional to the root of the squared error E of the pictures, so that a change that
adds e to E adds e / (2 E) of the loss. ``clgs.train.quality.importance`` estimates e.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.data.view import View
from clgs.opencl.device import Device
from clgs.ops import loss, mask
from clgs.render.frame import EXACT_ROOM, DeviceScene, upload_view
from clgs.render.rasterise import rasterise, with_enough_room
from clgs.train.config import TrainConfig
from clgs.train.quality.importance import Sensitivity, sensitivity
from clgs.train.state.run_state import render_settings

Floats = npt.NDArray[np.float64]

COMPARED = 8
"""Views on which the loss and the squared error are measured."""

PIXELS = 2.0
"""Pictures are drawn at half the resolution if this many pixels per anchor remain."""


@dataclass(frozen=True)
class Judgement:
    """What the loss gains by changes of the anchors.

    loss: the mean over views; importance (A,): what leaving an anchor out adds; curvature: makes,
    by name, that of offset (A, K, 3), feature (A, F) and scaling (A, 6): what a change of one
    element by d adds, divided by d squared. Float64, at least 0. If anchors that no view showed
    must stay, their importance is infinite, and their curvature the mean of the others.
    """

    loss: float
    importance: Floats
    curvature: Callable[[str], Floats]


def look(
    device: Device,
    config: TrainConfig,
    scene: DeviceScene,
    views: Sequence[View],
    curved: bool = True,
) -> Sensitivity:
    """How the squared error of a picture depends on the anchors, the mean over ``views``.

    ``curved``: whether changes of the attributes are looked at, too.
    """
    least = min(view.camera.width * view.camera.height for view in views)
    factor = 2 if least >= 4 * PIXELS * len(scene.anchors) else 1
    reduced = [view.camera.reduced(factor) for view in views]
    used = [view.used(factor) for view in views]
    settings, options = render_settings(config), config.render_options()
    found = sensitivity(device, scene, settings, reduced, options, curved, used=used)
    return found.times(factor**2 / len(views))


def compare(
    device: Device, config: TrainConfig, scene: DeviceScene, views: Sequence[View]
) -> tuple[float, float]:
    """Loss and squared error of a view, means over some of ``views``."""
    settings, options = render_settings(config), config.render_options()
    weights = loss.Weights(config.l1_weight, config.ssim_weight)
    losses, errors, room = [], [], EXACT_ROOM
    for view in views[:: -(-len(views) // COMPARED)]:
        drawn = upload_view(device, view.camera, settings)
        draw = partial(rasterise, device, scene, drawn, options)
        frame, room = with_enough_room(device, room, draw)
        photo = view.photo.planes(settings.background)
        image, used = frame.image, view.used()
        if used is not None:
            image, photo = mask.forward(device, image, device.upload(used)), photo * used
        compared = loss.forward(device, image, device.upload(photo), weights)
        losses.append(compared.value_later(device).get().value)
        residual = device.download(image) - photo / np.float32(255)
        errors.append(float(np.square(residual, dtype=np.float64).sum()))
        del frame, image  # before the next ones are made
    return float(np.mean(losses)), max(float(np.mean(errors)), np.finfo(np.float64).tiny)


def judge(
    found: Sensitivity, mean_loss: float, squared_error: float, unseen_stay: bool
) -> Judgement:
    """The anchors in units of the loss, by what :func:`look` and :func:`compare` found.

    ``unseen_stay``: there are more views, which may show what these do not.
    """
    worth = 0.5 * mean_loss / squared_error
    importance = found.importance.astype(np.float64) * worth
    unseen = unseen_stay and bool(found.seen.any())
    if unseen:
        importance[~found.seen] = np.inf

    def curvature(name: str) -> Floats:
        array = found.curvature[name].astype(np.float64) * worth
        if unseen:
            array[~found.seen] = array[found.seen].mean(axis=0)
        return array

    return Judgement(mean_loss, importance, curvature)
