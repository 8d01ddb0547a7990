"""Seeded synthetic scenes: of anchors in front of one camera, and those of `clgs conformance`.

The latter are the same bits wherever they are made. Their random numbers depend on nothing but this
file: no library's generator, no rounding. SplitMix64 (Steele, Lea and Flood 2014) gives the
integers; floats are multiples of 2^-24 made from them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.opencl.device import Device
from clgs.scene.anchors import AnchorSet
from clgs.scene.camera import Camera
from clgs.scene.mlps import MLP_SIZE, Mlps, init_mlps, unpack_head
from clgs.scene.scene import RenderSettings, Scene

DRAWN_SHARE = 0.4
"""Share of slots with positive opacity, as in trained scenes."""

DISTANCE = 4.0


def camera_of(width: int, height: int) -> Camera:
    """A camera DISTANCE before the origin that sees 53 degrees along the longer edge."""
    focal = float(max(width, height))
    place = np.array([0.0, 0.0, DISTANCE])
    return Camera(np.eye(3), place, focal, focal, width / 2, height / 2, width, height)


def anchor_scene(
    gaussians: int, size: int | tuple[int, int], seed: int = 0
) -> tuple[Scene, Camera]:
    """A scene of which about ``gaussians`` small neural Gaussians are drawn, and its camera.

    ``size``: pixels, of both edges or width and height. Anchors fill the middle of the view;
    Gaussians have a median standard deviation of about one pixel, as neural Gaussians of trained
    scenes do.
    """
    rng = np.random.default_rng(seed)
    count = max(1, round(gaussians / (DRAWN_SHARE * K_OFFSETS)))
    width, height = size if isinstance(size, tuple) else (size, size)
    edge = max(width, height)
    pixel = DISTANCE / edge
    filled = np.array([1.7 * (width / edge), 1.7 * (height / edge), 0.5])
    position = rng.uniform(-1, 1, (count, 3)) * filled
    scaling = np.log(pixel) + rng.normal(0.9, 0.4, (count, 6))
    anchors = AnchorSet(
        position.astype(np.float32),
        rng.normal(0, 1.0, (count, K_OFFSETS, 3)).astype(np.float32),
        rng.normal(0, 1.0, (count, FEATURE_DIM)).astype(np.float32),
        scaling.astype(np.float32),
    )
    camera = camera_of(width, height)
    # random MLPs whose opacity biases leave DRAWN_SHARE of the slots positive
    mlps = init_mlps(rng)
    layers = unpack_head(mlps.flat, "opacity")
    direction = anchors.position - camera.centre.astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inputs = np.concatenate([anchors.feature, direction], 1)
    hidden = np.maximum(inputs @ layers["hidden_weight"].T + layers["hidden_bias"], 0)
    logits = hidden @ layers["output_weight"].T
    layers["output_bias"][:] = -np.quantile(logits, 1 - DRAWN_SHARE, axis=0)
    return Scene(anchors, mlps), camera


GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX = ((np.uint64(30), 0xBF58476D1CE4E5B9), (np.uint64(27), 0x94D049BB133111EB))
TURNED = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
"""A rotation without rounding in its making."""

Tensor = tuple[str, str, npt.NDArray[Any]]
"""Stage, name and values."""


class ExactRandom:
    """A stream of random numbers from a seed."""

    def __init__(self, seed: int) -> None:
        self._state = np.uint64(seed)

    def integers(self, count: int) -> npt.NDArray[np.uint64]:
        """The next ``count`` integers, uniform over 64 bits."""
        steps = np.arange(1, count + 1, dtype=np.uint64)
        with np.errstate(over="ignore"):
            value = self._state + steps * GOLDEN
            self._state = self._state + np.uint64(count) * GOLDEN
            for shift, factor in MIX:
                value = (value ^ (value >> shift)) * np.uint64(factor)
        return np.asarray(value ^ (value >> np.uint64(31)))

    def floats(self, shape: Sequence[int], low: float, high: float) -> npt.NDArray[np.float32]:
        """float32 in [low, high): low + (high - low) k 2^-24, rounded once to float32."""
        unit = (self.integers(int(np.prod(shape))) >> np.uint64(40)).astype(np.float64) * 2.0**-24
        return (low + (high - low) * unit).astype(np.float32).reshape(tuple(shape))

    def bytes(self, shape: Sequence[int]) -> npt.NDArray[np.uint8]:
        """uint8 in [0, 256)."""
        high = self.integers(int(np.prod(shape))) >> np.uint64(56)
        return high.astype(np.uint8).reshape(tuple(shape))


@dataclass(frozen=True)
class ConformanceScene:
    """A scene, the view of it, and the photo (3, H, W) uint8 that it is compared with."""

    name: str
    scene: Scene
    camera: Camera
    photo: npt.NDArray[np.uint8]


def conformance_scenes() -> list[ConformanceScene]:
    """Small Gaussians seen straight on; large, turned and off-centre ones; needles."""
    straight = Camera(np.eye(3), np.array([0.0, 0, 4]), 80.0, 80.0, 40.0, 24.0, 80, 48)
    turned = Camera(TURNED, np.array([0.0, 0.25, 4]), 90.0, 110.0, 61.5, 40.25, 113, 77)
    return [
        _scene("small", straight, 400, (-4.0, -3.0)),
        _scene("large", turned, 300, (-3.0, -1.5)),
        _scene("needles", straight, 200, (-8.0, -0.5)),
    ]


def _scene(
    name: str, camera: Camera, anchors: int, log_size: tuple[float, float]
) -> ConformanceScene:
    """Anchors in a box of 3 x 2 x 2 around the origin; ``log_size``: range of their log scales."""
    random = ExactRandom(anchors)
    position = random.floats((anchors, 3), -1.0, 1.0) * np.array([1.5, 1, 1], np.float32)
    scene = Scene(
        AnchorSet(
            position,
            random.floats((anchors, K_OFFSETS, 3), -1.0, 1.0),
            random.floats((anchors, FEATURE_DIM), -1.0, 1.0),
            random.floats((anchors, 6), *log_size),
        ),
        Mlps(random.floats((MLP_SIZE,), -0.25, 0.25)),
        RenderSettings(background=(0.25, 0.5, 0.75)),
    )
    return ConformanceScene(name, scene, camera, random.bytes((3, camera.height, camera.width)))


def named(device: Device, stage: str, result: object, *names: str) -> Iterator[Tensor]:
    """The arrays of these names that a stage made."""
    for name in names:
        yield stage, name, device.download(getattr(result, name))
