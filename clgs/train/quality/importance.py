"""What the pictures lose if an anchor is left out, and how much of the pictures it makes up.

A pixel is linear in the opacity of each Gaussian, so an anchor left out changes the pictures by
d = -(sum over its Gaussians of opacity * d image / d opacity), to first order if they overlap.
The squared error that this adds is <d, d>, the mean of <noise, d>^2 over random signs
(Hutchinson's estimator): one backward pass and one draw per view, since many views see an anchor.
The product of d with the residual of training is left out on purpose: single anchors that seem to
do harm need each other, and leaving out thousands of them because of it costs far more.

A pixel is also the sum over its Gaussians of weight times color, with the weight alpha T. So the
gradient of a picture's sum by a Gaussian's color is the sum of its weights over the pixels: how
visible its anchor is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
import numpy.typing as npt

from clgs.data.masks import Mask
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import density
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import EXACT_ROOM, DeviceScene, Frame, upload_view
from clgs.render.rasterise import blend_backward, rasterise, rasterise_backward, with_enough_room
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene, RenderSettings

SEED = 0


@dataclass(frozen=True)
class Sensitivity:
    """How the squared error of pictures depends on the anchors of a scene.

    importance (A,): what leaving an anchor out adds to the error; curvature: of offset (A, K, 3),
    feature (A, F) and scaling (A, 6), what a change by d adds to it, divided by d squared. Float32,
    at least 0. seen (A,): whether a picture shows the anchor's place.
    """

    importance: npt.NDArray[np.float32]
    curvature: dict[str, npt.NDArray[np.float32]]
    seen: npt.NDArray[np.bool_]

    def times(self, factor: float) -> Sensitivity:
        """The same in units that are smaller by ``factor``."""
        scaled = {name: array * np.float32(factor) for name, array in self.curvature.items()}
        return Sensitivity(self.importance * np.float32(factor), scaled, self.seen)

    def mean(self, other: Sensitivity) -> Sensitivity:
        """The mean of two looks at the same anchors."""
        half = np.float32(0.5)
        curvature = {n: half * (array + other.curvature[n]) for n, array in self.curvature.items()}
        importance = half * (self.importance + other.importance)
        return Sensitivity(importance, curvature, self.seen | other.seen)

    def rows(self, kept: npt.NDArray[np.bool_]) -> Sensitivity:
        """The same for the anchors where ``kept`` (A,) is true."""
        curvature = {name: array[kept] for name, array in self.curvature.items()}
        return Sensitivity(self.importance[kept], curvature, self.seen[kept])


def sensitivity(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    curved: bool = True,
    on_render: Callable[[], None] = lambda: None,
    used: Sequence[Mask | None] = (),
) -> Sensitivity:
    """The importance of every anchor, and the diagonal of the Gauss-Newton matrix.

    Both are summed over the pixels and channels of all pictures, colors in [0, 1]. The matrix uses
    the same random signs: the mean of <signs, d image / d x>^2 is the squared length of
    d image / d x. Without ``curved`` it is left out, which is faster.

    ``on_render`` is called after each camera. ``used``: the pixels (H, W) uint8 of 0 and 1 that
    count, per camera; None, or without masks: all.
    """
    found = density.no_importance(device, len(scene.anchors))
    sizes = {n: array.shape for n, array in scene.anchors.items() if n != "position"}
    curvature = {name: device.zeros(size) for name, size in sizes.items() if curved}
    for frame, signs in _looks(device, scene, settings, cameras, options, used):
        if curved:
            gradients = rasterise_backward(device, scene, frame, signs, by_weights=False)
            for name, total in curvature.items():
                density.add_curvature(device, total, getattr(gradients, f"d_{name}"))
            d_opacity = gradients.d_projected.d_opacity
            del gradients
        else:
            d_opacity = blend_backward(device, frame, signs).d_opacity
        visible = frame.activations.visible
        density.add_importance(device, found, visible, frame.gaussians, d_opacity)
        del frame, signs, d_opacity  # before the next ones are made
        on_render()
    sums = {name: device.download(array) for name, array in curvature.items()}
    return Sensitivity(device.download(found.total), sums, device.download(found.seen) > 0)


def feature_products(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_render: Callable[[], None] = lambda: None,
    used: Sequence[Mask | None] = (),
) -> npt.NDArray[np.float64]:
    """How errors e (F,) of an anchor's features add up: e @ products @ e, as the squared error.

    The block of the Gauss-Newton matrix for the features of an anchor, (F, F), summed over all
    anchors. Arguments are those of :func:`sensitivity`.
    """
    features = scene.anchors.feature.shape[1]
    products = np.zeros((features, features))
    for frame, signs in _looks(device, scene, settings, cameras, options, used):
        gradients = rasterise_backward(device, scene, frame, signs, by_weights=False)
        d_feature = device.download(gradients.d_feature).astype(np.float64)
        products += d_feature.T @ d_feature
        del frame, signs, gradients  # before the next ones are made
        on_render()
    return products


def _looks(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    options: RenderOptions,
    used: Sequence[Mask | None],
) -> Iterator[tuple[Frame, DeviceArray]]:
    """The frame of each camera, and random signs for its pixels, 0 where they do not count."""
    rng, room = np.random.default_rng(SEED), EXACT_ROOM
    for camera, mask in zip_longest(cameras, used):
        view = upload_view(device, camera, settings)
        frame, room = with_enough_room(rasterise, device, scene, view, options, room)
        random = 2 * rng.integers(0, 2, frame.image.shape, np.int8).astype(np.float32) - 1
        signs = device.upload(random if mask is None else random * mask)
        yield frame, signs
        del frame, signs  # before the next ones are made


def importance_without_views(scene: QuantizedScene) -> npt.NDArray[np.float64]:
    """A stand-in (A,) float64 if there are no views: the area that an anchor covers.

    The product of the two largest of its three shape scales.
    """
    shape = scene.anchors.scaling[:, 3:] / scene.scales.scaling
    return np.asarray(np.exp(np.clip(np.sort(shape, axis=1)[:, 1:].sum(axis=1), -80.0, 80.0)))


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
        frame, room = with_enough_room(rasterise, device, scene, view, options, room)
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
