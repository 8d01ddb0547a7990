"""Refine ordinary Gaussians by gradient descent until they look like pictures of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, loss, mask
from clgs.options import RenderOptions
from clgs.render.frame import EXACT_ROOM, DeviceView
from clgs.render.rasterise import rasterise, rasterise_backward, with_enough_room
from clgs.scene.gaussians import HostGaussians

RATES = {"mean": 3e-5, "log_scale": 4e-3, "rotation": 2e-3, "opacity": 2e-2, "sh": 2e-3}
"""Learning rates of the first step; that of the mean in units of the cameras' radius."""

LAST_RATE = 0.1
"""Rates fall exponentially, to this share of the first ones."""


@dataclass(frozen=True)
class Target:
    """A view and what it is to show, on the device.

    picture (3, H, W) uint8, zero where it is masked; used (H, W) uint8 of 0 and 1, None if nothing
    is masked.
    """

    view: DeviceView
    picture: DeviceArray
    used: DeviceArray | None = None


def refine(
    device: Device,
    gaussians: HostGaussians,
    targets: Iterable[Target],
    steps: int,
    radius: float,
    options: RenderOptions,
    on_step: Callable[[], None] = lambda: None,
) -> HostGaussians:
    """One step of Adam for each of the first ``steps`` targets, with the loss of training.

    ``targets``: at least ``steps``; ``radius``: of the cameras, scene units; ``on_step`` is called
    after each step.

    Raises:
        ClgsError: a gradient is not finite.
    """
    stored, room = gaussians.map(device.upload), EXACT_ROOM
    moments = {name: adam.zero_moments(device, array) for name, array in stored.items()}
    stop = adam.stop_flag(device)
    for number, target in zip(range(1, steps + 1), targets, strict=False):
        draw = partial(rasterise, device, stored, target.view, options)
        frame, room = with_enough_room(device, room, draw)
        image, picture, used = frame.image, target.picture, target.used
        image = image if used is None else mask.forward(device, image, used)
        compared = loss.forward(device, image, picture)
        d_image = loss.backward(device, image, picture, compared)
        d_image = d_image if used is None else mask.backward(device, d_image, used)
        gradients = dict(rasterise_backward(device, stored, frame, d_image).d_stored.items())
        del frame  # before the next one is made
        adam.check_finite(device, gradients.values(), stop)
        fall = LAST_RATE ** ((number - 1) / max(steps - 1, 1))
        updates = []
        for name, array in stored.items():
            rate = RATES[name] * (radius if name == "mean" else 1.0) * fall
            trained = adam.Trained(array, gradients[name], moments[name])
            updates.append(adam.Update(trained, adam.factors(rate, number)))
        adam.step(device, updates, stop)
        on_step()
    if device.download(stop)[0]:
        raise ClgsError("baking: a gradient is not finite; give --steps 0 to export unrefined")
    return stored.map(device.download)
