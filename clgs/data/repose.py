"""Move a dataset's cameras into the units of another scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgs.data.dataset import Dataset
from clgs.data.view import View
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform

UNLIKE = 0.25
"""Scenes whose centres or units differ by a larger share are not of one capture."""


def repose(dataset: Dataset, transform: SceneTransform) -> Dataset:
    """The dataset with cameras in the units of ``transform``; unchanged if it has them already.

    A scene keeps the transform that it was trained with; the photos that were added or removed
    since then would normalise to slightly different units.
    """
    if dataset.transform == transform:
        return dataset

    def move(view: View) -> View:
        return replace(view, camera=move_camera(view.camera, dataset.transform, transform))

    return replace(
        dataset,
        train=[move(view) for view in dataset.train],
        test=[move(view) for view in dataset.test],
        transform=transform,
    )


def alike(one: SceneTransform, other: SceneTransform, radius: float) -> bool:
    """Whether two transforms may be of the same photos, with a few added or removed.

    Args:
        one: world to scene.
        other: world to another scene.
        radius: of the cameras in the units of ``one``.
    """
    apart = one.scale * np.linalg.norm(np.subtract(one.centre, other.centre))
    ratio = max(one.scale, other.scale) / min(one.scale, other.scale)
    return bool(apart < UNLIKE * radius and ratio < 1 + UNLIKE)


def move_camera(camera: Camera, old: SceneTransform, new: SceneTransform) -> Camera:
    """The camera in the units of ``new``: x_cam scales with the scene, t = scale (R centre + t)."""
    world = camera.translation / old.scale - camera.rotation @ np.array(old.centre)
    translation = new.scale * (camera.rotation @ np.array(new.centre) + world)
    return replace(camera, translation=translation)
