"""Scenes in space through projection, tile lists and blend, on a device and in float64."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from clgs.constants import NEAR_PLANE
from clgs.ops import blend as blend_op
from clgs.ops import project, tiles
from clgs.ops.neural import Gaussians
from clgs.reference import blend as blend_reference
from clgs.reference import project as project_reference
from clgs.reference.tiles import TileLists
from clgs.scene.camera import Camera
from tests.compare import relative_l2
from tests.gaussians import SIGMA_SPREAD, GaussianScene
from tests.ops.cases.blend import BACKGROUND, Rendered, decisions

LEVEL = 1 / 255
PARTS = tuple(field.name for field in fields(GaussianScene))
GRADIENTS = tuple(f"d_{name}" for name in PARTS)
SHAPE = ("mean", "scale", "rotation")
DISTANCE = 4.0


@dataclass(frozen=True)
class Drawn:
    """A scene after the kernels, and its Gaussians on the device."""

    scene: GaussianScene
    camera: np.ndarray
    gaussians: Gaussians
    rendered: Rendered

    @property
    def device(self) -> Any:
        return self.rendered.device

    @property
    def size(self) -> tuple[int, int]:
        return int(self.camera[16]), int(self.camera[17])

    @property
    def image(self) -> np.ndarray:
        return self.rendered.host("image")

    def projected(self, name: str) -> np.ndarray:
        return self.device.download(getattr(self.rendered.inputs["projected"], name))

    @property
    def visible(self) -> np.ndarray:
        return self.projected("extent")[:, 0] > 0


def straight_camera(width: int, height: int, focal: float | None = None) -> Camera:
    """A camera DISTANCE before the origin that looks along z; by default 53 degrees wide."""
    focal = float(max(width, height)) if focal is None else focal
    return Camera(
        np.eye(3), np.array([0, 0, DISTANCE]), focal, focal, width / 2, height / 2, width, height
    )


def space_scene(
    rng: np.random.Generator,
    count: int,
    camera: Camera,
    sigma: float = 3.0,
    ratio: float = 4.0,
    spread: float = 0.6,
) -> GaussianScene:
    """Gaussians before ``straight_camera``, sizes in pixels.

    Args:
        rng: source of all randomness.
        count: number of Gaussians.
        camera: from :func:`straight_camera`.
        sigma: median of the longest standard deviation, pixels (log-normal).
        ratio: longest to shortest axis; the third lies in between.
        spread: the centres fill this many image sizes each way; 0.5 is the image.
    """
    depth = DISTANCE * rng.uniform(0.5, 2, count)
    pixel = rng.uniform(-spread, spread, (count, 2)) * (camera.width, camera.height)
    mean = np.column_stack([pixel * (depth / camera.fx)[:, None], depth - DISTANCE])
    longest = sigma * np.exp(SIGMA_SPREAD * rng.normal(size=count)) * depth / camera.fx
    shrink = np.column_stack([np.ones(count), ratio ** -rng.uniform(size=count), np.ones(count)])
    shrink[:, 2] = 1 / ratio
    shrink = rng.permuted(shrink, axis=1)
    rotation = rng.normal(size=(count, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    return GaussianScene(
        mean=mean.astype(np.float32),
        scale=(longest[:, None] * shrink).astype(np.float32),
        rotation=rotation.astype(np.float32),
        color=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        opacity=rng.uniform(0.02, 0.9, count).astype(np.float32),
    )


def part(scene: GaussianScene, keep: np.ndarray) -> GaussianScene:
    """The Gaussians of an index or mask."""
    return GaussianScene(**{name: getattr(scene, name)[keep] for name in PARTS})


def changed(scene: GaussianScene, name: str, index: Any, value: Any) -> GaussianScene:
    """A copy in which ``name[index]`` is ``value``."""
    array = getattr(scene, name).copy()
    with np.errstate(over="ignore"):
        array[index] = value
    return replace(scene, **{name: array})


def draw(
    device: Any,
    scene: GaussianScene,
    camera: Camera,
    near: float = NEAR_PLANE,
    background: np.ndarray = BACKGROUND,
) -> Drawn:
    """Render on the device."""
    packed = camera.pack(near)
    gaussians = Gaussians(**{name: device.upload(array) for name, array in vars(scene).items()})
    projected = project.forward(device, gaussians, device.upload(packed))
    inputs = {
        "projected": projected,
        "tiles": tiles.forward(device, projected, (camera.width, camera.height)),
        "background": device.upload(background),
    }
    blended = blend_op.forward(device, **inputs)
    return Drawn(scene, packed, gaussians, Rendered(device, inputs, blended))


def image_gradient(camera: Camera) -> np.ndarray:
    """A random d_image (3, H, W) float32."""
    shape = (3, camera.height, camera.width)
    return np.random.default_rng(7).normal(size=shape).astype(np.float32)


def gradients(drawn: Drawn, d_image: np.ndarray) -> dict[str, np.ndarray]:
    """Gradients of all five parts of the scene, by GRADIENTS."""
    device, rendered = drawn.device, drawn.rendered
    projected, camera = rendered.inputs["projected"], device.upload(drawn.camera)
    by_screen = blend_op.backward(device, projected, rendered.blended, device.upload(d_image))
    found = project.backward(device, drawn.gaussians, camera, projected, by_screen)
    return {name: device.download(getattr(found, name)) for name in GRADIENTS}


def decided(drawn: Drawn, d_image: np.ndarray) -> blend_reference.Decisions:
    """What both kernels decided about every pixel; fails where they differ."""
    ahead, back = decisions(drawn.rendered, d_image)
    assert np.array_equal(ahead.contributed, back.contributed)
    assert np.array_equal(ahead.saturated, back.saturated)
    return ahead


@dataclass(frozen=True)
class Expected:
    """The float64 image and gradients under the kernels' decisions."""

    image: np.ndarray
    gradients: dict[str, np.ndarray]


def matched(drawn: Drawn, d_image: np.ndarray) -> Expected:
    """Repeat projection, blend and both backward passes in float64, decisions given.

    Fails where the forward and the backward kernel decided differently.
    """
    ahead = decided(drawn, d_image)
    wide = {name: getattr(drawn.scene, name).astype(np.float64) for name in PARTS}
    shape = tuple(wide[name] for name in SHAPE)
    projected = project_reference.forward(*shape, wide["opacity"], drawn.camera)
    background = drawn.device.download(drawn.rendered.inputs["background"]).astype(np.float64)
    scene = projected, wide["color"], wide["opacity"], host_lists(drawn), background
    image = blend_reference.forward(*scene, drawn.size, ahead).image
    splats = blend_reference.backward(*scene, ahead, d_image.astype(np.float64))
    d_mean, d_scale, d_rotation = project_reference.backward(
        shape, drawn.camera, projected, splats.d_mean2d, splats.d_whitening
    )
    found = dict(zip(GRADIENTS, (d_mean, d_scale, d_rotation), strict=False))
    return Expected(image, {**found, "d_color": splats.d_color, "d_opacity": splats.d_opacity})


def host_lists(drawn: Drawn) -> TileLists:
    """The kernels' tile lists, for the reference."""
    lists = drawn.rendered.inputs["tiles"]
    names = (field.name for field in fields(TileLists))
    return TileLists(**{name: drawn.device.download(getattr(lists, name)) for name in names})


def trained(scene: GaussianScene, found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Gradients as they are trained: of the scale by its logarithm, where it can be large."""
    return {**found, "d_scale": found["d_scale"] * scene.scale.astype(np.float64)}


def assert_matches(
    drawn: Drawn, d_image: np.ndarray, level: float = 5e-3, gradient: float = 1e-5
) -> None:
    """Image within ``level`` levels and gradients within relative L2 ``gradient`` of float64."""
    expected = matched(drawn, d_image)
    error = np.abs(drawn.image - expected.image) / LEVEL
    assert error.max(initial=0) <= level
    actual = trained(drawn.scene, gradients(drawn, d_image))
    for name, wanted in trained(drawn.scene, expected.gradients).items():
        assert relative_l2(actual[name], wanted) <= gradient, name


def all_finite(drawn: Drawn, d_image: np.ndarray) -> bool:
    """Whether image, transmittance and all gradients hold nothing but numbers."""
    arrays = [drawn.image, drawn.rendered.host("transmittance")]
    arrays += gradients(drawn, d_image).values()
    return all(np.isfinite(array).all() for array in arrays)
