"""Cameras and points seen along an axis, as a drawing (SVG)."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
import numpy.typing as npt

from clgs.data.posed_photo import Photo

SIZE = 480
"""Width and height of the drawing, pixels."""

MAX_POINTS = 4000
KEPT = 0.9
"""Share of the points that the drawing must hold; those far away are cut off."""

CAMERA = 0.035
"""Length of a camera, of the drawing's width."""

Floats = npt.NDArray[np.float64]


def draw_map(photos: Sequence[tuple[Photo, str]], points: Floats, axes: Floats) -> str:
    """The drawing.

    Args:
        photos: each with the class of its mark.
        points: (P, 3), world units.
        axes: (2, 3), the directions to the right and down, unit.
    """
    centres = np.array([photo.centre for photo, _ in photos]) @ axes.T
    flat = points[:: max(1, len(points) // MAX_POINTS)] @ axes.T
    low, size = _frame(centres, flat)
    scale = SIZE / size
    dots = (flat - low) * scale
    inside = dots[((dots >= 0) & (dots <= SIZE)).all(1)]
    path = "".join(f"M{x:.0f} {y:.0f}h0" for x, y in inside)
    marks = "".join(
        _mark(photo, kind, (centre - low) * scale, axes)
        for (photo, kind), centre in zip(photos, centres, strict=True)
    )
    return (
        f'<svg class="chart plan" role="img" viewBox="0 0 {SIZE} {SIZE}" '
        f'aria-label="cameras and points"><path class="points" d="{path}"/>{marks}</svg>'
    )


def _frame(centres: Floats, points: Floats) -> tuple[Floats, float]:
    """Upper left corner (2,) and width of a square that holds all cameras and most points."""
    lower, upper = centres.min(0), centres.max(0)
    if len(points):
        tail = (1 - KEPT) / 2
        lower = np.minimum(lower, np.quantile(points, tail, axis=0))
        upper = np.maximum(upper, np.quantile(points, 1 - tail, axis=0))
    size = 1.1 * max(float((upper - lower).max()), 1e-12)
    return np.asarray((lower + upper - size) / 2), size


def _mark(photo: Photo, kind: str, centre: Floats, axes: Floats) -> str:
    """A triangle that opens where the camera looks."""
    forward, aside = axes @ photo.rotation[2], axes @ photo.rotation[0]
    length = CAMERA * SIZE
    half = 0.5 * photo.lens.width / photo.lens.fx
    corners = [centre, *(centre + length * (forward + side * half * aside) for side in (-1, 1))]
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    title = f"<title>{escape(photo.name)}</title>"
    return f'<polygon class="camera {kind}" points="{text}">{title}</polygon>'
