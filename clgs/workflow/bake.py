"""Bake a scene of neural Gaussians to ordinary ones.

If there is no data set, what is stored says little about its cameras. A data set of photos is
scaled so that its cameras lie within SCENE_RADIUS / RADIUS_MARGIN of the origin, the farthest at
that distance. Cameras to bake from stand on two spheres within, and look at the middle of the
anchors. A scene of Blender keeps its units: cameras stand around the anchors, far enough to see
them all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.constants import ALPHA_CUT, BLUR, K_OFFSETS
from clgs.data.dataset import RADIUS_MARGIN, SCENE_RADIUS
from clgs.data.masks import Mask
from clgs.errors import DataError
from clgs.opencl.device import Device
from clgs.render.frame import upload_scene, upload_view
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import Scene, SplatScene
from clgs.train.quality.scores import psnr_8bit, to_8bit
from clgs.workflow.bake_fit import Observation, Target, fit, observe, refine

VIEWS = 96
SIZE = 400
"""Pixels of an edge."""
FIELD = 0.7
"""Radians across."""
SHELLS = (1.0, 0.6)
"""Radii of the spheres that cameras stand on in turn, in units of the largest."""
MOST_ANCHORS = 0.9
"""Share of the anchors that cameras are to see."""


def cameras_around(scene: Scene) -> list[Camera]:
    """VIEWS cameras in scene units, evenly spread; always the same ones for a scene."""
    position = scene.anchors.position.astype(np.float64)
    middle = np.median(position, axis=0)
    if scene.transform.is_identity:
        extent = np.quantile(np.linalg.norm(position - middle, axis=1), MOST_ANCHORS)
        stand, radius = middle, float(extent) / np.sin(FIELD / 2)
    else:
        stand, radius = np.zeros(3), SCENE_RADIUS / RADIUS_MARGIN
    # equal steps of height, turned by the golden angle
    height = 1 - (2 * np.arange(VIEWS) + 1) / VIEWS
    angle = np.arange(VIEWS) * np.pi * (3 - np.sqrt(5))
    around = np.sqrt(1 - height**2)
    directions = np.column_stack([around * np.cos(angle), around * np.sin(angle), height])
    shells = radius * np.resize(SHELLS, VIEWS)
    cameras, focal, half = [], SIZE / 2 / np.tan(FIELD / 2), SIZE / 2
    for r, direction in zip(shells, directions, strict=True):
        centre = stand + r * direction
        forward = middle - centre
        forward /= max(float(np.linalg.norm(forward)), 1e-9)
        side = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])  # any side may be up
        side /= max(float(np.linalg.norm(side)), 1e-9)
        rotation = np.stack([side, np.cross(forward, side), forward])
        place = focal, focal, half, half, SIZE, SIZE
        cameras.append(Camera(rotation, -rotation @ centre, *place))
    return cameras


FIT_VIEWS = 64
"""Most views that the fit looks at, evenly chosen; refinement sees all."""

ORDER_BITS = 16
"""Bits of a coordinate in the order of the Gaussians."""

WIDENED = 0.3
"""Mic at 200x200 is 0.6 and 0.4 dB worse after refinement with none and with all of the blur."""

SEED = 0

Planes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class BakeSettings:
    """degree: of the spherical harmonics, 0 to 3; steps: of refinement, 0 for none.

    antialiased: whether the Gaussians are for viewers that draw such ones (Mip-Splatting).
    """

    degree: int = 3
    steps: int = 500
    antialiased: bool = False


@dataclass(frozen=True)
class BakeView:
    """A camera in scene units, and what gives its photo (3, H, W) uint8.

    Without a photo the scene is rendered instead. ``used`` gives the photo's mask (H, W) uint8 of 0
    and 1, or None if every pixel counts.
    """

    camera: Camera
    photo: Callable[[], Planes] | None = None
    used: Callable[[], Mask | None] = lambda: None


def bake(
    device: Device,
    scene: Scene,
    views: Sequence[BakeView],
    settings: BakeSettings,
    on_step: Callable[[], None] = lambda: None,
) -> HostGaussians:
    """Ordinary Gaussians in scene units that look like ``scene`` from ``views``.

    First, ordinary Gaussians are fitted to what the neural ones show to the views, weighted by what
    they contribute. Then all numbers are refined against the photos, or against renders of the
    scene. What no view sees is left out. ``on_step`` is called ``count_steps`` times.

    Raises:
        DataError: no view sees anything of the scene.
    """
    uploaded = upload_scene(device, scene)
    seen = evenly(views, FIT_VIEWS)

    def observations() -> Iterator[Observation]:
        on_device = (
            (upload_view(device, view.camera, scene.settings), view.used()) for view in seen
        )
        for observation in observe(device, uploaded, on_device):
            yield observation
            on_step()

    fitted = fit(observations, len(scene.anchors) * K_OFFSETS, settings.degree)
    if not len(fitted):
        raise DataError("baking: no view sees anything of the scene; is --data that of the scene?")
    # the radius of the cameras around their mean, as training measures it
    centres = np.array([view.camera.centre for view in views])
    distance = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    radius = RADIUS_MARGIN * float(distance) or 1.0
    pictures = _pictures(device, scene, views)
    if settings.antialiased:
        fitted = _antialiased(fitted, [view.camera for view in views])
    refined = refine(device, fitted, pictures, settings.steps, radius, on_step)
    return in_order(without_faint(refined))


def _antialiased(fitted: HostGaussians, cameras: Sequence[Camera]) -> HostGaussians:
    """Antialiased ones to begin with, wider by WIDENED of the blur that was learned with."""
    pixel = np.zeros((len(fitted), 1))  # its mean edge at each Gaussian, scene units
    for one in cameras:
        away = np.linalg.norm(fitted.mean - one.centre, axis=1, keepdims=True)
        pixel += away / (one.fx * len(cameras))
    log_scale = 0.5 * np.log(np.exp(2 * fitted.log_scale) + WIDENED * BLUR * pixel**2)
    return replace(fitted, log_scale=log_scale.astype(np.float32), antialiased=True)


def count_steps(views: int, settings: BakeSettings) -> int:
    """How often ``bake`` calls ``on_step``."""
    return 2 * min(views, FIT_VIEWS) + settings.steps


def evenly(views: Sequence[BakeView], most: int) -> list[BakeView]:
    """Choose at most ``most`` of ``views``, evenly."""
    chosen = np.linspace(0, len(views) - 1, min(len(views), most)).round().astype(int)
    return [views[i] for i in chosen]


def _pictures(device: Device, scene: Scene, views: Sequence[BakeView]) -> Iterator[Target]:
    """All views in random order, again and again, and what they are to show."""
    rng = np.random.default_rng(SEED)
    renderer = Renderer(device, scene)
    while True:
        for number in rng.permutation(len(views)):
            view = views[number]
            if view.photo is not None:
                planes = view.photo()
            else:
                planes = to_8bit(renderer.render(view.camera)).transpose(2, 0, 1)
            seen, used = upload_view(device, view.camera, scene.settings), view.used()
            picture = device.upload(np.ascontiguousarray(planes if used is None else planes * used))
            yield seen, picture, None if used is None else device.upload(used)


def without_faint(gaussians: HostGaussians) -> HostGaussians:
    """The Gaussians whose opacity is above the cut of alpha: no picture shows the others."""
    kept = gaussians.opacity > np.log(ALPHA_CUT / (1 - ALPHA_CUT))
    return gaussians.map(lambda array: array[kept])


def in_order(gaussians: HostGaussians) -> HostGaussians:
    """The Gaussians in Morton order of their means, which files compress best."""
    least, most = gaussians.mean.min(axis=0), gaussians.mean.max(axis=0)
    step = float((most.astype(np.float64) - least).max()) / (2**ORDER_BITS - 1)
    cells = ((gaussians.mean - least) / (step or 1.0)).astype(np.uint64)
    code = np.zeros(len(cells), np.uint64)
    for bit in range(ORDER_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    order = np.argsort(code, kind="stable")
    return gaussians.map(lambda array: np.ascontiguousarray(array[order]))


@dataclass(frozen=True)
class BakedLoss:
    """What baking costs: mean PSNR over ``views`` views, in dB, against their photos, masked.

    baked: of the baked Gaussians; scene: of the scene that they were baked from. Without photos
    ``baked`` is against renders of the scene, and ``scene`` is None.
    """

    views: int
    baked: float
    scene: float | None


def baked_loss(
    device: Device,
    scene: Scene,
    gaussians: HostGaussians,
    views: Sequence[BakeView],
) -> BakedLoss:
    """Draw ``scene`` and ``gaussians``, in scene units, from ``views``, and compare."""
    renderer = Renderer(device, scene)
    of_baked = Renderer(device, SplatScene(gaussians, scene.settings))
    baked, before = [], []
    for view in views:
        whole = to_8bit(renderer.render(view.camera))
        picture = to_8bit(of_baked.render(view.camera))
        if view.photo is None:
            baked.append(psnr_8bit(picture, whole))
            continue
        photo = np.ascontiguousarray(view.photo().transpose(1, 2, 0))
        used = view.used()
        baked.append(psnr_8bit(picture, photo, used))
        before.append(psnr_8bit(whole, photo, used))
    return BakedLoss(len(views), float(np.mean(baked)), float(np.mean(before)) if before else None)
