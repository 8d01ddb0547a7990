"""A photo laid over the render of the camera that took it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clgs.data.masks import USED
from clgs.data.view import Color, View
from clgs.exports.pictures import Picture, error_map
from clgs.scene.camera import Camera

RENDER, PHOTO, HALVES, ERROR = "render", "photo", "half photo, half render", "error"
SHOWN = (RENDER, PHOTO, HALVES, ERROR)
"""The pictures that can be shown at the camera of a photo."""

NEAR = 1e-3
"""A camera stands at a photo's if it is no further away, in scene units and radians."""


def stands_at(camera: Camera, view: View) -> bool:
    """Whether a camera has the place and the direction of a photo's."""
    there = view.camera
    far = float(np.linalg.norm(camera.centre - there.centre))
    cosine = (np.trace(camera.rotation @ there.rotation.T) - 1) / 2
    return bool(
        far <= NEAR * max(1.0, float(np.linalg.norm(there.centre))) and cosine > 1 - NEAR**2
    )


def compare(render: Picture, camera: Camera, view: View, background: Color, shown: str) -> Picture:
    """The picture that ``shown``, one of SHOWN, names: render, photo or both, (H, W, 3) uint8.

    ``camera`` stands where the photo was taken; what it sees, ``render`` (H, W, 3) uint8, surrounds
    the photo. ``background`` fills what is transparent in it.

    Raises:
        DataError: the photo is damaged.
    """
    if shown == RENDER:
        return render
    photo = np.ascontiguousarray(view.photo.planes(background).transpose(1, 2, 0))
    placed, (top, left, bottom, right) = _placed(photo, camera, view.camera)
    result = render.copy()
    inside = render[top:bottom, left:right]
    if shown == ERROR:
        placed = error_map(placed, np.ascontiguousarray(inside))
        if (used := view.used()) is not None:  # masked pixels have no error
            mask = np.repeat(used[..., None] * np.uint8(255), 3, axis=2)
            placed = placed * (_placed(mask, camera, view.camera)[0] >= USED)
    if shown == HALVES:
        middle = (right - left) // 2
        result[top:bottom, left : left + middle] = placed[:, :middle]
        return result
    result[top:bottom, left:right] = placed
    return result


def _placed(
    photo: Picture, camera: Camera, taken: Camera
) -> tuple[Picture, tuple[int, int, int, int]]:
    """The photo as ``camera`` sees it, and its box (top, left, bottom, right) in the picture."""
    from PIL import Image

    x, y = camera.fx / taken.fx, camera.fy / taken.fy
    left, top = camera.cx - taken.cx * x, camera.cy - taken.cy * y
    box = [round(top), round(left), round(top + taken.height * y), round(left + taken.width * x)]
    box = [max(0, box[0]), max(0, box[1]), min(camera.height, box[2]), min(camera.width, box[3])]
    box[2], box[3] = max(box[2], box[0] + 1), max(box[3], box[1] + 1)
    source = (
        max(0.0, (box[1] - left) / x),
        max(0.0, (box[0] - top) / y),
        min(photo.shape[1], (box[3] - left) / x),
        min(photo.shape[0], (box[2] - top) / y),
    )
    size = box[3] - box[1], box[2] - box[0]
    resized = Image.fromarray(photo).resize(size, Image.Resampling.LANCZOS, box=source)
    return np.asarray(resized, np.uint8), (box[0], box[1], box[2], box[3])


def names_of(views: Sequence[View]) -> list[str]:
    """Names to choose photos by, all different."""
    seen: dict[str, int] = {}
    names = []
    for view in views:
        count = seen[view.name] = seen.get(view.name, 0) + 1
        names.append(view.name if count == 1 else f"{view.name} ({count})")
    return names
