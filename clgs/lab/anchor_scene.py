"""A seeded synthetic scene of anchors in front of one camera, for benchmarks and self-tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.data.dataset import Dataset
from clgs.data.images import Pixels
from clgs.data.stored_photo import StoredPhoto
from clgs.data.view import View
from clgs.scene.anchors import AnchorSet
from clgs.scene.camera import Camera
from clgs.scene.mlps import init_mlps, unpack_head
from clgs.scene.scene import Scene, SceneTransform

DRAWN_SHARE = 0.4
"""Share of slots with positive opacity, as in trained scenes."""

DISTANCE = 4.0


def camera_of(width: int, height: int) -> Camera:
    """A camera DISTANCE before the origin that sees 53 degrees along the longer edge."""
    focal = float(max(width, height))
    place = np.array([0.0, 0.0, DISTANCE])
    return Camera(np.eye(3), place, focal, focal, width / 2, height / 2, width, height)


def square_camera(size: int) -> Camera:
    """A camera like :func:`camera_of` with ``size`` x ``size`` pixels."""
    return camera_of(size, size)


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


def photo_dataset(camera: Camera, points: npt.NDArray[np.float32], seed: int = 0) -> Dataset:
    """A data set of one smooth random photo seen by ``camera``; ``points`` (P, 3) to start from."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (camera.height // 8 + 1, camera.width // 8 + 1, 3))
    image = np.kron(coarse, np.ones((8, 8, 1)))[: camera.height, : camera.width].astype(np.uint8)
    photo = StoredPhoto.of(Pixels(np.ascontiguousarray(image), None))
    view = View("synthetic", camera, photo)
    return Dataset(
        train=[view],
        test=[],
        points=points,
        point_colors=None,
        transform=SceneTransform(),
        radius=1.0,
        kind="transforms",
        skipped=0,
    )
