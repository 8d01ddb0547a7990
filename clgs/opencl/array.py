"""Arrays that live on an OpenCL device."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class DeviceArray:
    """A C-contiguous array in a device buffer; the memory returns to the pool with the object.

    ``buffer`` is what kernels take as argument; an empty array still has a buffer of one element.
    ``part``: the array of bytes of which it is a part, and the byte where it begins, if it is one.
    """

    buffer: Any
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    part: tuple[DeviceArray, int] | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Number of bytes of the elements."""
        return self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return self.shape[0]

    def of_type(self, dtype: npt.DTypeLike) -> DeviceArray:
        """The same memory, its bits read as numbers of another dtype of the same size."""
        return replace(self, dtype=np.dtype(dtype))

    def first(self, rows: int) -> DeviceArray:
        """The first ``rows``, in the same memory."""
        return replace(self, shape=(rows, *self.shape[1:]))
