"""Arrays that live on an OpenCL device."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl


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


def part_of(whole: DeviceArray, begin: int, shape: tuple[int, ...]) -> DeviceArray:
    """An array of float32 from byte ``begin`` of an array of bytes on, in the same memory."""
    memory: Any = cl.Buffer.from_int_ptr(whole.buffer.int_ptr, retain=True)  # pools have no regions
    region = memory.get_sub_region(begin, 4 * max(math.prod(shape), 1))
    return DeviceArray(region, shape, np.dtype(np.float32), (whole, begin))
