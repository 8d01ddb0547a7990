"""Refine ordinary Gaussians by gradient descent until they look like pictures of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, loss
from clgs.options import RenderOptions
from clgs.render.frame import DeviceView
from clgs.render.splats import splats_backward, splats_forward
from clgs.scene.gaussians import DeviceGaussians, HostGaussians

RATES = {"mean": 3e-5, "log_scale": 4e-3, "rotation": 2e-3, "opacity": 2e-2, "sh": 2e-3}
"""Learning rates of the first step; that of the mean in units of the cameras' radius."""

LAST_RATE = 0.1
"""Of the first: rates fall exponentially."""


@dataclass(frozen=True)
class Target:
    """A view, and what it is to show: a picture (3, H, W) uint8 on the device."""

    view: DeviceView
    picture: DeviceArray


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

    Args:
        device: where to work.
        gaussians: in scene units.
        targets: at least ``steps``.
        steps: number of them.
        radius: of the cameras, scene units.
        options: of the renders.
        on_step: called after each.

    Raises:
        ClgsError: a gradient is not finite.
    """
    stored = gaussians.map(device.upload)
    moments = {name: adam.zero_moments(device, array) for name, array in stored.items()}
    stop = adam.stop_flag(device)
    for number, target in zip(range(1, steps + 1), targets, strict=False):
        gradients = dict(_gradients(device, stored, target, options).items())
        adam.check_finite(device, gradients.values(), stop)
        fall = LAST_RATE ** ((number - 1) / max(steps - 1, 1))
        updates = []
        for name, array in stored.items():
            rate = RATES[name] * (radius if name == "mean" else 1.0) * fall
            trained = adam.Trained(array, gradients[name], moments[name])
            updates.append(adam.Update(trained, adam.factors(rate, number)))
        adam.step_all(device, updates, stop)
        on_step()
    if device.download(stop)[0]:
        raise ClgsError("baking: a gradient is not finite; give --steps 0 to export unrefined")
    return stored.map(device.download)


def _gradients(
    device: Device, stored: DeviceGaussians, target: Target, options: RenderOptions
) -> DeviceGaussians:
    frame = splats_forward(device, stored, target.view, options)
    compared = loss.forward(device, frame.image, target.picture)
    d_image = loss.backward(device, frame.image, target.picture, compared)
    return splats_backward(device, stored, frame, d_image).stored
