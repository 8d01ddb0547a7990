"""Scenes on the screen, on the device and in float64, for the tests of tiles and blend."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from clgs.lab.kernels import blend_decisions
from clgs.ops import blend, tiles
from clgs.ops.project import Projected
from clgs.options import DEFAULT, RenderOptions
from clgs.reference import blend as reference
from clgs.reference import project as reference_project
from clgs.reference.tiles import TileLists
from tests.gaussians import ProjectedScene

GEOMETRY = ("mean2d", "whitening", "depth", "extent")
GRADIENTS = ("d_mean2d", "d_whitening", "d_color", "d_opacity")
BACKGROUND = np.array([0.2, 0.5, 0.9], np.float32)


@dataclass(frozen=True)
class Rendered:
    """A scene after the kernels, all that the backward pass needs."""

    device: Any
    inputs: dict[str, Any]
    blended: blend.Blended

    def host(self, name: str) -> np.ndarray:
        return self.device.download(getattr(self.blended, name))

    def backward(self, d_image: np.ndarray) -> dict[str, np.ndarray]:
        result = blend.backward(
            self.device, self.inputs["projected"], self.blended, self.device.upload(d_image)
        )
        return {name: self.device.download(getattr(result, name)) for name in GRADIENTS}


def upload(device: Any, scene: ProjectedScene) -> Projected:
    return Projected(**{name: device.upload(array) for name, array in vars(scene).items()})


def lists_of(
    device: Any, scene: ProjectedScene, size: tuple[int, int], options: RenderOptions = DEFAULT
) -> tiles.TileLists:
    return tiles.forward(device, upload(device, scene), size, options)


def render(
    device: Any,
    scene: ProjectedScene,
    size: tuple[int, int],
    lists: tiles.TileLists | None = None,
    background: np.ndarray = BACKGROUND,
    options: RenderOptions = DEFAULT,
) -> Rendered:
    inputs = {
        "projected": upload(device, scene),
        "tiles": lists or lists_of(device, scene, size, options),
        "background": device.upload(background),
    }
    return Rendered(device, inputs, blend.forward(device, **inputs, options=options))


def in_float64(rendered: Rendered, scene: ProjectedScene) -> dict[str, Any]:
    """The reference's arguments: the same float32 inputs and the kernels' own lists."""
    lists = rendered.inputs["tiles"]
    names = (field.name for field in fields(TileLists))
    host = {name: rendered.device.download(getattr(lists, name)) for name in names}
    return {
        "projected": reference_project.Projected(
            **{name: getattr(scene, name).astype(np.float64) for name in GEOMETRY}
        ),
        "color": scene.color.astype(np.float64),
        "opacity": scene.opacity.astype(np.float64),
        "tiles": TileLists(**host),
        "background": rendered.device.download(rendered.inputs["background"]).astype(np.float64),
    }


def decisions(rendered: Rendered, d_image: np.ndarray) -> tuple[Any, Any]:
    """What forward and backward decide, as the reference takes it."""
    device = rendered.device
    return blend_decisions(device, rendered.blended, device.upload(d_image))


def every_tile_lists(device: Any, scene: ProjectedScene, size: tuple[int, int]) -> tiles.TileLists:
    """Lists that hold every drawn Gaussian in every tile."""
    count, number = len(scene.depth), tiles.tile_count(*size)
    drawn = np.flatnonzero(scene.extent[:, 0] > 0)
    order = drawn[np.argsort(scene.depth[drawn], kind="stable")]
    counts = np.zeros(count, np.int64)
    counts[drawn] = number
    row_range = np.concatenate([[0], np.cumsum(counts)])
    arrays = {
        "gaussian": np.tile(order, number),
        "row": (row_range[order][None, :] + np.arange(number)[:, None]).ravel(),
        "tile_range": np.arange(number + 1) * len(order),
        "row_range": row_range,
    }
    total = device.upload(np.array([len(arrays["row"])], np.int64))
    uploaded = {name: device.upload(array.astype(np.int32)) for name, array in arrays.items()}
    return tiles.TileLists(size=size, **uploaded, total=total)


def truncation(options: RenderOptions) -> reference.Truncation:
    """The accuracy of ``options``, as the reference takes it."""
    accuracy = options.accuracy
    return reference.Truncation(
        accuracy.alpha_cut, accuracy.transmittance_stop, accuracy.inclusive_stop
    )


def stack(opacity: np.ndarray, rng: np.random.Generator) -> ProjectedScene:
    """Layers (n, p): each a Gaussian that covers one of p pixels of a row, and no other."""
    layers, pixels = opacity.shape
    mean2d = np.stack(np.broadcast_arrays(np.arange(pixels) + 0.5, np.full(opacity.shape, 0.5)), 2)
    count = layers * pixels
    return ProjectedScene(
        mean2d=mean2d.reshape(count, 2).astype(np.float32),
        whitening=np.tile(np.float32([20.0, 0.0, 20.0]), (count, 1)),
        depth=np.repeat(np.arange(1, layers + 1), pixels).astype(np.float32),
        extent=np.full((count, 2), 0.2, np.float32),
        color=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        opacity=opacity.reshape(count).astype(np.float32),
    )


def regime(kind: str, layers: int, rng: np.random.Generator) -> np.ndarray:
    """Opacities (layers, 8) that leave light for the last layers."""
    opacity = rng.uniform(1.02 / 255, 8.5 / layers + 1.1 / 255, (layers, 8))
    if kind == "mixed":
        opacity[rng.integers(0, layers, 3)] = 0.5
    if kind == "opaque last":
        opacity[-1] = 0.99
    return opacity
