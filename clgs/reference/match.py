"""Descriptors of a photo, and the nearest ones of another photo, in integers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def nearest(
    own: npt.NDArray[np.uint8], other: npt.NDArray[np.uint8]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Index, largest and second largest dot product, (M,) each, of rows of (M, L) and (N, L).

    The first of several nearest ones counts. Products that do not exist are 0, their index too.
    """
    products = own.astype(np.int64) @ other.astype(np.int64).T
    products = np.pad(products, ((0, 0), (0, 2)))  # as if there were two more, of zeros
    order = np.argsort(-products, axis=1, kind="stable")[:, :2]
    largest, second = np.take_along_axis(products, order, 1).T
    return np.where(largest > 0, order[:, 0], 0), largest, second
