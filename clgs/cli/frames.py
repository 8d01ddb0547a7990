"""Pictures of colors, depth or opacity that `clgs render` writes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.export.image import Picture, heat
from clgs.render.renderer import Depth, Renderer
from clgs.scene.camera import Camera
from clgs.train.quality.metrics import to_8bit

LOOKS = 12
"""Cameras whose depths give the range of the colors of all pictures."""

LOOK_REDUCTION = 8
LOOK_SHARES = 2, 98
"""Percentiles of the depths that get the lightest and the darkest color."""

SEEN = 0.5
"""Least opacity of a pixel whose depth counts for that range."""


@dataclass(frozen=True)
class Frame:
    """A picture (H, W, 3) uint8 and, of a picture of depth, the depths (H, W) float32."""

    picture: Picture
    depth: npt.NDArray[np.float32] | None = None


class Frames:
    """Draws frames of one kind: "color", "depth" or "opacity".

    Depth is shown from light (near) to dark (far), evenly in 1 / depth, in the same range for all
    frames, and black where nothing is.
    """

    def __init__(self, renderer: Renderer, kind: str, cameras: Sequence[Camera]) -> None:
        """``cameras``: of all frames."""
        self._renderer, self._kind = renderer, kind
        self._range = self._depths(cameras) if kind == "depth" else (1.0, 2.0)

    def draw(self, camera: Camera) -> Frame:
        """The frame of a camera in scene units."""
        if self._kind == "color":
            return Frame(to_8bit(self._renderer.render(camera)))
        seen = self._renderer.depth(camera)
        if self._kind == "opacity":
            return Frame(to_8bit(np.repeat(seen.opacity[None], 3, axis=0)))
        return Frame(self._shade(seen), seen.depth)

    def _depths(self, cameras: Sequence[Camera]) -> tuple[float, float]:
        """The range (near, far) of the depths that some of ``cameras`` see, scene units."""
        found = []
        for camera in cameras[:: max(1, len(cameras) // LOOKS)]:
            seen = self._renderer.depth(camera.reduced(LOOK_REDUCTION))
            found.append(seen.depth[seen.opacity > SEEN])
        depths = np.concatenate(found) if found else np.empty(0)
        if not len(depths):
            return 1.0, 2.0
        near, far = np.percentile(depths, LOOK_SHARES)
        return float(near), float(max(far, near * 1.001))

    def _shade(self, seen: Depth) -> Picture:
        near, far = self._range
        depth = np.clip(seen.depth.astype(np.float64), near, far)
        closeness = (1 / depth - 1 / far) / (1 / near - 1 / far)
        shown = heat(0.1 + 0.9 * closeness) * seen.opacity[..., None]
        return np.asarray(np.rint(np.clip(shown, 0, 255)), np.uint8)
