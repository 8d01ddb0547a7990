"""What the pictures lose if an anchor is left out.

A pixel is linear in the opacity of each Gaussian, so an anchor left out changes the pictures by
d = -(sum over its Gaussians of opacity * d image / d opacity), to first order if they overlap.
The squared error that this adds is <d, d>, the mean of <noise, d>^2 over random signs
(Hutchinson's estimator): one backward pass and one draw per view, since many views see an anchor.
The product of d with the residual of training is left out on purpose: single anchors that seem to
do harm are needed by each other, and leaving out thousands of them by it costs far more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import Frame, upload_scene
from clgs.render.pipeline import blend_backward, render_forward
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene

SEED = 0


def importance(
    device: Device,
    scene: QuantizedScene,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_render: Callable[[], None] = lambda: None,
) -> npt.NDArray[np.float64]:
    """The squared error of the pictures from ``cameras`` that each anchor saves, (A,) float64.

    At least 0. Summed over pixels and channels, colors in [0, 1]. ``on_render`` is called after
    each camera.
    """
    total, rng = np.zeros(len(scene.anchors)), np.random.default_rng(SEED)
    uploaded = upload_scene(device, scene.dequantize())
    for camera in cameras:
        frame = render_forward(device, uploaded, camera, scene.settings, options)
        signs = 2 * rng.integers(0, 2, frame.image.shape, np.int8).astype(np.float32) - 1
        anchor, change = _change(device, frame, signs)
        total[anchor] += np.square(change)
        on_render()
    return total


def importance_without_views(scene: QuantizedScene) -> npt.NDArray[np.float64]:
    """A stand-in (A,) float64 if there are no views: the area that an anchor covers.

    The product of the two largest of its three shape scales.
    """
    shape = scene.anchors.scaling[:, 3:] / scene.scales.scaling
    return np.asarray(np.exp(np.clip(np.sort(shape, axis=1)[:, 1:].sum(axis=1), -80.0, 80.0)))


def _change(
    device: Device, frame: Frame, direction: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """The anchors of the frame (n,), each once, and <d, ``direction``> of each."""
    gaussians = frame.gaussians
    gradients = blend_backward(device, frame, device.upload(direction))
    change = device.download(gaussians.opacity) * device.download(gradients.d_opacity)
    visible = device.download(frame.activations.visible)
    row = device.download(gaussians.slot) // K_OFFSETS
    seen = visible >= 0
    return visible[seen], np.bincount(row, change, len(visible))[seen].astype(np.float64)
