"""The mean gradient of the views of a batch; float64."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def mean(gradients: Sequence[Array]) -> Array:
    """The mean of gradients of one shape, one per view."""
    return np.asarray(np.mean(np.stack(gradients), axis=0))
