"""Bake a scene of neural Gaussians to ordinary ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.bake.fit import fit
from clgs.bake.observe import Observation, observe
from clgs.bake.refine import Target, refine
from clgs.constants import ALPHA_CUT, K_OFFSETS
from clgs.data.dataset import RADIUS_MARGIN
from clgs.errors import DataError
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene, upload_view
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import Scene, SceneTransform
from clgs.train.quality.metrics import to_8bit

FIT_VIEWS = 64
"""At most so many views, evenly chosen, are looked at for the fit; refinement sees all."""

ORDER_BITS = 16
"""Of each coordinate, for the order of the Gaussians."""

SEED = 0

Planes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class BakeSettings:
    """degree: of the spherical harmonics, 0 to 3; steps: of refinement, 0 for none."""

    degree: int = 3
    steps: int = 500


@dataclass(frozen=True)
class BakeView:
    """A camera in scene units, and how to get its photo (3, H, W) uint8; None: render the scene."""

    camera: Camera
    photo: Callable[[], Planes] | None = None


def bake(
    device: Device,
    scene: Scene,
    views: Sequence[BakeView],
    settings: BakeSettings | None = None,
    options: RenderOptions = DEFAULT,
    on_step: Callable[[], None] = lambda: None,
) -> HostGaussians:
    """Ordinary Gaussians in scene units that look like ``scene`` from ``views``.

    What neural Gaussians show to the views is fitted first, weighted by what they contribute;
    then all numbers are refined against the photos, or against renders of the scene.

    Args:
        device: where to work.
        scene: what to bake.
        views: where to look from; what none of them sees is left out.
        settings: what to make.
        options: of the renders.
        on_step: called ``count_steps`` times.

    Raises:
        DataError: no view sees anything of the scene.
    """
    settings = settings or BakeSettings()
    uploaded = upload_scene(device, scene)
    looked_at = evenly(views, FIT_VIEWS)

    def observations() -> Iterator[Observation]:
        for view in looked_at:
            on_device = upload_view(device, view.camera, scene.settings)
            yield observe(device, uploaded, on_device, options)
            on_step()

    fitted = fit(observations, len(scene.anchors) * K_OFFSETS, settings.degree)
    if not len(fitted):
        raise DataError("baking: no view sees anything of the scene; is --data that of the scene?")
    targets = _targets(device, scene, views, options)
    radius = _radius([view.camera for view in views])
    refined = refine(device, fitted, targets, settings.steps, radius, options, on_step)
    return in_order(without_faint(refined))


def count_steps(views: int, settings: BakeSettings) -> int:
    """How often ``bake`` calls ``on_step``."""
    return 2 * min(views, FIT_VIEWS) + settings.steps


def evenly(views: Sequence[BakeView], most: int) -> list[BakeView]:
    """At most ``most`` of them, evenly chosen."""
    chosen = np.linspace(0, len(views) - 1, min(len(views), most)).round().astype(int)
    return [views[i] for i in chosen]


def _radius(cameras: Sequence[Camera]) -> float:
    """That of the cameras around their mean, as training measures it."""
    centres = np.array([camera.centre for camera in cameras])
    distance = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    return RADIUS_MARGIN * float(distance) or 1.0


def _targets(
    device: Device, scene: Scene, views: Sequence[BakeView], options: RenderOptions
) -> Iterator[Target]:
    """All views in random order, again and again."""
    rng = np.random.default_rng(SEED)
    renderer = Renderer(device, scene, options)
    while True:
        for number in rng.permutation(len(views)):
            view = views[number]
            if view.photo is not None:
                planes = view.photo()
            else:
                planes = to_8bit(renderer.render(view.camera)).transpose(2, 0, 1)
            picture = device.upload(np.ascontiguousarray(planes))
            yield Target(upload_view(device, view.camera, scene.settings), picture)


def without_faint(gaussians: HostGaussians) -> HostGaussians:
    """Those whose opacity is above the cut of alpha: no picture shows the others."""
    kept = gaussians.opacity > np.log(ALPHA_CUT / (1 - ALPHA_CUT))
    return gaussians.map(lambda array: array[kept])


def in_order(gaussians: HostGaussians) -> HostGaussians:
    """In Morton order of the means, which files compress best."""
    least, most = gaussians.mean.min(axis=0), gaussians.mean.max(axis=0)
    step = float((most.astype(np.float64) - least).max()) / (2**ORDER_BITS - 1)
    cells = ((gaussians.mean - least) / (step or 1.0)).astype(np.uint64)
    code = np.zeros(len(cells), np.uint64)
    for bit in range(ORDER_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    order = np.argsort(code, kind="stable")
    return gaussians.map(lambda array: np.ascontiguousarray(array[order]))


def to_world(gaussians: HostGaussians, transform: SceneTransform) -> HostGaussians:
    """From scene units to those of the data set; directions stay, and so do colors."""
    mean = transform.to_world(gaussians.mean.astype(np.float64))
    return _resized(gaussians, mean, 1.0 / transform.scale)


def to_scene(gaussians: HostGaussians, transform: SceneTransform) -> HostGaussians:
    """The inverse of :func:`to_world`."""
    mean = transform.to_scene(gaussians.mean.astype(np.float64))
    return _resized(gaussians, mean, transform.scale)


def _resized(
    gaussians: HostGaussians, mean: npt.NDArray[np.float64], factor: float
) -> HostGaussians:
    log_scale = gaussians.log_scale + np.float32(np.log(factor))
    return replace(gaussians, mean=mean.astype(np.float32), log_scale=log_scale)
