"""What the pictures lose if an anchor is left out.

A pixel is linear in the opacity of each Gaussian, so an anchor left out changes the pictures by
d = -(sum over its Gaussians of opacity * d image / d opacity), to first order if they overlap.
The squared error that this adds is <d, d>, the mean of <noise, d>^2 over random signs
(Hutchinson's estimator): one backward pass and one draw per view, since many views see an anchor.
The product of d with the residual of training is left out on purpose: single anchors that seem to
do harm are needed by each other, and leaving out thousands of them by it costs far more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.ops import density
from clgs.ops.project import ProjectedGradients
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import EXACT_ROOM, DeviceScene, Frame, upload_view
from clgs.render.pipeline import blend_backward, roomy_forward, scene_backward
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene, RenderSettings

SEED = 0


def importance(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_render: Callable[[], None] = lambda: None,
) -> npt.NDArray[np.float64]:
    """The squared error of the pictures from ``cameras`` that each anchor saves, (A,) float64.

    At least 0. Summed over pixels and channels, colors in [0, 1]. ``on_render`` is called after
    each camera.
    """
    found = density.no_importance(device, len(scene.anchors))
    for frame, gradients in _sign_passes(device, scene, settings, cameras, options):
        _add_importance(device, found, frame, gradients)
        del frame, gradients  # before the next ones are made
        on_render()
    return device.download(found.total).astype(np.float64)


@dataclass(frozen=True)
class Sensitivity:
    """How the squared error of pictures goes with the anchors of a scene.

    importance (A,): what leaving an anchor out adds to it; curvature: of offset (A, K, 3), feature
    (A, F) and scaling (A, 6), what a change by d adds to it, divided by d squared. Float32. seen
    (A,): whether a picture shows the anchor's place.
    """

    importance: npt.NDArray[np.float32]
    curvature: dict[str, npt.NDArray[np.float32]]
    seen: npt.NDArray[np.bool_]

    def times(self, factor: float) -> Sensitivity:
        """In units that are smaller by ``factor``."""
        scaled = {name: array * np.float32(factor) for name, array in self.curvature.items()}
        return Sensitivity(self.importance * np.float32(factor), scaled, self.seen)

    def mean(self, other: Sensitivity) -> Sensitivity:
        """Of two looks at the same anchors."""
        half = np.float32(0.5)
        curvature = {n: half * (array + other.curvature[n]) for n, array in self.curvature.items()}
        importance = half * (self.importance + other.importance)
        return Sensitivity(importance, curvature, self.seen | other.seen)

    def rows(self, kept: npt.NDArray[np.bool_]) -> Sensitivity:
        """Of the anchors that ``kept`` (A,) says."""
        curvature = {name: array[kept] for name, array in self.curvature.items()}
        return Sensitivity(self.importance[kept], curvature, self.seen[kept])


def sensitivity(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    curved: bool = True,
) -> Sensitivity:
    """The importance of :func:`importance`, and the diagonal of the Gauss-Newton matrix.

    Both are summed over the pictures. The latter by the same random signs: the mean of
    <signs, d image / d x>^2 is the squared length of d image / d x. It is left out unless
    ``curved``.
    """
    found = density.no_importance(device, len(scene.anchors))
    sizes = {n: array.shape for n, array in scene.anchors.items() if n != "position"}
    curvature = {name: device.zeros(size) for name, size in sizes.items() if curved}
    for frame, gradients in _sign_passes(device, scene, settings, cameras, options):
        _add_importance(device, found, frame, gradients)
        if curved:
            derivatives = scene_backward(device, scene, frame, gradients)
            for name, total in curvature.items():
                density.add_curvature(device, total, getattr(derivatives, f"d_{name}"))
            del derivatives
        del frame, gradients  # before the next ones are made
    sums = {name: device.download(array) for name, array in curvature.items()}
    return Sensitivity(device.download(found.total), sums, device.download(found.seen) > 0)


def importance_without_views(scene: QuantizedScene) -> npt.NDArray[np.float64]:
    """A stand-in (A,) float64 if there are no views: the area that an anchor covers.

    The product of the two largest of its three shape scales.
    """
    shape = scene.anchors.scaling[:, 3:] / scene.scales.scaling
    return np.asarray(np.exp(np.clip(np.sort(shape, axis=1)[:, 1:].sum(axis=1), -80.0, 80.0)))


def _sign_passes(
    device: Device,
    scene: DeviceScene,
    settings: RenderSettings,
    cameras: Sequence[Camera],
    options: RenderOptions,
) -> Iterator[tuple[Frame, ProjectedGradients]]:
    """The frame of each camera, and what its backward pass makes of random signs."""
    rng, room = np.random.default_rng(SEED), EXACT_ROOM
    for camera in cameras:
        view = upload_view(device, camera, settings)
        frame, room = roomy_forward(device, scene, view, options, room)
        signs = 2 * rng.integers(0, 2, frame.image.shape, np.int8).astype(np.float32) - 1
        yield frame, blend_backward(device, frame, device.upload(signs))
        del frame


def _add_importance(
    device: Device, found: density.Importance, frame: Frame, gradients: ProjectedGradients
) -> None:
    """Add <d, signs>^2 of every anchor of the frame to what was ``found``."""
    visible = frame.activations.visible
    density.add_importance(device, found, visible, frame.gaussians, gradients.d_opacity)
