"""The axes of glTF files, whose y points up, and those of data sets.

Blender captures and transforms.json files have z up. COLMAP models have no up of their own; theirs
is taken to be -y, as if the first camera was held upright.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_FROM_Z_UP = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
_FROM_Y_DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))


def to_y_up(kind: str) -> npt.NDArray[np.float64]:
    """The rotation (3, 3) from the world of a data set to glTF's axes; its transpose goes back.

    Args:
        kind: of the data set: "blender", "transforms" or "colmap".
    """
    return np.array(_FROM_Y_DOWN if kind == "colmap" else _FROM_Z_UP)
