"""``clgs.decode_anchors``: the neural Gaussians that a camera sees of a scene, and gradients.

The stages are those of the trainer: ``cull``, ``mlp`` and ``neural``, forward and backward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_type
from clgs.constants import K_OFFSETS
from clgs.opencl.device import Device
from clgs.ops import cull, mlp, neural
from clgs.render.rasterization import default_device
from clgs.render.splat_arguments import Floats, check_numbers
from clgs.scene.anchors import AnchorSet
from clgs.scene.camera import Camera
from clgs.scene.mlps import MLP_SIZE
from clgs.scene.scene import Scene
from clgs.shapes import Shapes

Indices = npt.NDArray[np.int32]

FIELDS = {
    "means": ("mean", "N 3"),
    "quats": ("rotation", "N 4"),
    "scales": ("scale", "N 3"),
    "opacities": ("opacity", "N"),
    "colors": ("color", "N 3"),
}
"""What the stages call each array of Gaussians, and its shape for ``clgs.shapes``."""


def check_floats(name: str, array: object) -> None:
    """TypeError unless ``array`` is NumPy's, of float32; ValueError if a number is not finite."""
    if not isinstance(array, np.ndarray):
        raise TypeError(f"{name}: is {type(array).__name__}; give a NumPy array")
    if array.dtype != np.float32:
        raise TypeError(f"{name}: dtype is {array.dtype}, expected float32")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: {array.shape} has numbers that are not finite")


@dataclass(frozen=True)
class DecodedAnchors:
    """N Gaussians, float32, as :func:`clgs.rasterization` takes them, and their gradients.

    means (N, 3) and scales (N, 3) scene units; quats (N, 4) unit quaternions w x y z, or zeros if
    an MLP gave no direction; opacities (N,) above 0, at most 1; colors (N, 3) RGB, 0 to 1;
    anchor_ids (N,) int32 row of each one's anchor, offset_ids (N,) int32 which of its offsets.
    """

    means: Floats
    quats: Floats
    scales: Floats
    opacities: Floats
    colors: Floats
    anchor_ids: Indices
    offset_ids: Indices
    device: Device
    inputs: mlp.Inputs
    activations: mlp.Activations
    gaussians: neural.NeuralGaussians

    def __len__(self) -> int:
        return len(self.opacities)

    def backward(
        self,
        d_means: Floats | None = None,
        d_quats: Floats | None = None,
        d_scales: Floats | None = None,
        d_opacities: Floats | None = None,
        d_colors: Floats | None = None,
    ) -> dict[str, Floats]:
        """Gradients of the sum of all arrays times their ``d_``, by the scene.

        Args:
            d_means: (N, 3) float32; None for zeros, as of all arguments.
            d_quats: (N, 4) float32.
            d_scales: (N, 3) float32.
            d_opacities: (N,) float32.
            d_colors: (N, 3) float32.

        Returns:
            "offset" (A, K, 3), "feature" (A, F), "scaling" (A, 6) and "weights" (13710,) float32;
            those of anchors that are not seen are zeros. Positions lie on the grid of the file and
            have no gradient, and neither has the camera.

        Raises:
            ValueError, TypeError: an array has the wrong shape or dtype; names it.
        """
        device, shapes = self.device, Shapes(N=len(self))
        d_arrays = d_means, d_quats, d_scales, d_opacities, d_colors
        hosts = {}
        for (name, (field, spec)), array in zip(FIELDS.items(), d_arrays, strict=True):
            if array is None:
                array = np.zeros(getattr(self, name).shape, np.float32)
            check_type(f"d_{name}", array, np.ndarray, "give a NumPy array")
            shapes.check(f"d_{name}", array, spec, np.float32)
            hosts[f"d_{field}"] = np.ascontiguousarray(array)
        given = {name: device.share(array) for name, array in hosts.items()}
        d_gaussians = neural.GaussianGradients(**given)
        with device.stage("neural backward"):
            d_neural = neural.backward(
                device, self.gaussians, self.activations, self.inputs.anchors, d_gaussians
            )
        with device.stage("mlp backward"):
            d_mlp = mlp.backward(device, self.inputs, self.activations, d_neural.d_output)
        made = {
            "offset": d_neural.d_offset,
            "feature": d_mlp.d_feature,
            "scaling": d_neural.d_scaling,
            "weights": d_mlp.d_weights,
        }
        return {name: device.hand_over(array) for name, array in made.items()}


def decode_anchors(scene: Scene, camera: Camera, device: Device | None = None) -> DecodedAnchors:
    """The neural Gaussians that ``camera`` sees of a Voxel-GS scene: one per slot that is drawn.

    They come anchor by anchor, in an order that depends on the camera; ``anchor_ids`` and
    ``offset_ids`` say where each belongs. Arrays of ``scene`` must not change before the last
    call of :meth:`DecodedAnchors.backward`: a CPU device reads them where they are.

    Args:
        scene: of A anchors; its near plane decides with the camera which of them are seen.
        camera: it decides about colors, opacities and shapes, too: the MLPs read its direction.
        device: where it is computed; default a device that is opened once.

    Raises:
        TypeError: an argument is of another class, or an array no float32; names it.
        ValueError: an array has the wrong shape or a number that is not finite; names it.
    """
    check_type("scene", scene, Scene, "of a quantised one give scene.dequantize()")
    check_type("camera", camera, Camera, "of a view give view.camera")
    return decode(
        device or default_device(), scene.anchors, scene.mlps.flat, camera, scene.settings.near
    )


def decode(
    device: Device, anchors: AnchorSet, weights: Floats, camera: Camera, near: float
) -> DecodedAnchors:
    """What :func:`decode_anchors` does, of ``weights`` (13710,) and a near plane in scene units."""
    check_numbers(near=near)
    for name, array in (*anchors.items(), ("weights", weights)):
        check_floats(name, array)
    Shapes().check("weights", weights, str(MLP_SIZE), np.float32)
    shared = anchors.map(lambda array: device.share(np.ascontiguousarray(array)))
    packed = device.upload(camera.pack(near))
    inputs = mlp.Inputs(shared, device.share(np.ascontiguousarray(weights)), packed)
    with device.stage("cull"):
        seen = cull.forward(device, shared, packed).anchor
    with device.stage("mlp forward"):
        activations = mlp.forward(device, inputs, seen)
    with device.stage("neural forward"):
        gaussians = neural.forward(device, activations, shared)
    slot = device.download(gaussians.slot)
    visible = device.download(activations.visible)
    return DecodedAnchors(
        **{n: device.hand_over(getattr(gaussians, field)) for n, (field, _) in FIELDS.items()},
        anchor_ids=visible[slot // K_OFFSETS],
        offset_ids=slot % K_OFFSETS,
        device=device,
        inputs=inputs,
        activations=activations,
        gaussians=gaussians,
    )
