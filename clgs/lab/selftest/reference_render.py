"""A whole render and its backward pass in float64, and the distance of a result from them.

The render is decision-matched: the order of Gaussians, the contributors of every pixel and the
saturation of alpha come from the device. Only rounding is left to differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.lab.observed_kernels import blend_decisions
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.reference import blend, loss, mlp, neural, project, tiles
from clgs.render.frame import Frame
from clgs.scene.scene import Scene

Array = npt.NDArray[np.float64]
Gradients = dict[str, Array]

Timed = tuple[str, str, float, float, Callable[[], object]]
"""Stage, quantity, error, limit, and the work that is timed."""


@dataclass(frozen=True)
class ReferenceFrame:
    """Float64 results of every stage of one render."""

    scene: dict[str, Array]
    camera: Array
    background: Array
    activations: mlp.Activations
    gaussians: neural.NeuralGaussians
    projected: project.Projected
    lists: tiles.TileLists
    decisions: blend.Decisions
    image: Array


def wide(scene: Scene) -> dict[str, Array]:
    """The scene's parameters in float64."""
    arrays = {**dict(scene.anchors.items()), "weights": scene.mlps.flat}
    return {name: array.astype(np.float64) for name, array in arrays.items()}


def render_reference(
    device: Device, scene: Scene, frame: Frame, d_image: DeviceArray
) -> ReferenceFrame:
    """Repeat a render of the device in float64.

    Args:
        device: what rendered ``frame``.
        scene: what was rendered.
        frame: the render.
        d_image: (3, H, W) float32; the backward kernel's decisions must equal the forward one's.

    Raises:
        ValueError: forward and backward kernels decided differently.
    """
    host = wide(scene)
    camera = device.download(frame.view.camera).astype(np.float64)
    visible = device.download(frame.activations.visible)
    activations = mlp.forward(host["feature"], host["position"], visible, host["weights"], camera)
    gaussians = neural.forward(
        activations.output, visible, host["position"], host["offset"], host["scaling"]
    )
    projected = project.forward(
        gaussians.mean, gaussians.scale, gaussians.rotation, gaussians.opacity, camera
    )
    names = ("gaussian", "row", "tile_range", "row_range")
    found = {name: device.download(getattr(frame.tiles, name)) for name in names}
    lists = tiles.TileLists(**found)
    decisions, back = blend_decisions(device, frame.blended, d_image)
    if not np.array_equal(decisions.contributed, back.contributed):
        raise ValueError("forward and backward kernels disagree on contributors")
    background = device.download(frame.view.background).astype(np.float64)
    image = blend.forward(
        projected, gaussians.color, gaussians.opacity, lists, background, frame.view.size, decisions
    ).image
    return ReferenceFrame(
        host, camera, background, activations, gaussians, projected, lists, decisions, image
    )


def backward_reference(frame: ReferenceFrame, d_image: Array, volume_weight: float) -> Gradients:
    """d_offset, d_feature, d_scaling, d_weights for given d_image (3, H, W) float64."""
    shape = (frame.gaussians.mean, frame.gaussians.scale, frame.gaussians.rotation)
    splats = blend.backward(
        frame.projected,
        frame.gaussians.color,
        frame.gaussians.opacity,
        frame.lists,
        frame.background,
        frame.decisions,
        d_image,
    )
    d_mean, d_scale, d_rotation = project.backward(
        shape, frame.camera, frame.projected, splats.d_mean2d, splats.d_whitening
    )
    d_scale = d_scale + loss.volume(frame.gaussians.scale, volume_weight)[1]
    d_gaussians = neural.GaussianGradients(
        d_mean, d_scale, d_rotation, splats.d_color, splats.d_opacity
    )
    d_output, d_offset, d_scaling, _ = neural.backward(
        frame.gaussians,
        frame.activations.output,
        frame.activations.visible,
        frame.scene["offset"],
        frame.scene["scaling"],
        d_gaussians,
    )
    d_weights, d_feature, _ = mlp.backward(
        frame.activations, frame.scene["position"], frame.scene["weights"], frame.camera, d_output
    )
    return {
        "d_offset": d_offset,
        "d_feature": d_feature,
        "d_scaling": d_scaling,
        "d_weights": d_weights,
    }


@dataclass(frozen=True)
class Check:
    """One quantity of one stage: its error, the limit, and the stage's median milliseconds.

    The stage passes if ``error <= limit``; NaN does not.
    """

    stage: str
    quantity: str
    error: float
    limit: float
    milliseconds: float

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the limit."""
        return self.error <= self.limit

    @property
    def share(self) -> float:
        """The error in units of its limit; not a number if the error is not."""
        return self.error / self.limit if self.limit else self.error * np.inf if self.error else 0.0


def failed(stage: str, error: Exception) -> Check:
    """A check that an exception ended; its quantity says what happened."""
    said = " ".join(str(error).split())[:200]
    return Check(stage, f"{type(error).__name__}: {said}", float("nan"), 0.0, 0.0)


def relative_errors(
    device: Device, found: object, wanted: object, names: Iterable[str]
) -> dict[str, float]:
    """:func:`relative_l2` of each named array of two records, the first of them on ``device``."""
    return {
        name: relative_l2(device.download(getattr(found, name)), getattr(wanted, name))
        for name in names
    }


def largest(actual: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """Largest absolute difference; infinite for different shapes, NaN spreads."""
    if actual.shape != expected.shape:
        return float("inf")
    return float(np.max(np.abs(actual.astype(np.float64) - expected), initial=0.0))


def relative_l2(actual: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """||actual - expected|| / ||expected||; infinite for different shapes, NaN spreads."""
    if actual.shape != expected.shape:
        return float("inf")
    norm = float(np.linalg.norm(np.asarray(expected, np.float64)))
    error = float(np.linalg.norm(actual.astype(np.float64) - expected))
    return error / norm if norm else error
