"""How well pairs of points in two photos agree with a relative pose."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def sampson_error(rotation: Floats, translation: Floats, left: Floats, right: Floats) -> Floats:
    """Distance (M,) of ideal-plane points (M, 2) from agreeing with a relative pose.

    Args:
        rotation: (3, 3), of the second camera's axes from the first's.
        translation: (3,), likewise; any length but zero.
        left: points in the first photo, in focal lengths.
        right: the same points in the second.
    """
    x, y, z = translation
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    left = np.column_stack([left, np.ones(len(left))])
    right = np.column_stack([right, np.ones(len(right))])
    line_right, line_left = left @ essential.T, right @ essential
    residual = np.abs(np.einsum("ij,ij->i", right, line_right))
    slope = np.hypot(
        np.hypot(line_right[:, 0], line_right[:, 1]), np.hypot(line_left[:, 0], line_left[:, 1])
    )
    return np.asarray(residual / np.maximum(slope, 1e-300))
