"""Attribute rows by the plain run-length coder that the paper uses, to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from clgs import _codec


def encode(value: npt.NDArray[np.int32]) -> bytes:
    """The plain stream of ``value`` (rows, channels) int32, 1 to 256 channels."""
    return _codec.paper_encode(np.ascontiguousarray(value, np.int32), value.shape[1])


def decode(data: bytes | memoryview, rows: int, channels: int) -> npt.NDArray[np.int32]:
    """The matrix (rows, channels) int32 of a stream; the caller has bounded ``rows``.

    Raises:
        ValueError: the stream is damaged, or holds another number of rows.
    """
    value = np.empty((rows, channels), np.int32)
    _codec.paper_decode(data, value, channels)
    return value


@dataclass(frozen=True)
class PaperModel:
    """A chunk is a plain stream; nothing is shared."""

    channels: int
    MODE: ClassVar[int] = 2
    """The first byte of the header: the chunks are plain run-length streams."""
    looks_near: ClassVar[bool] = False

    @property
    def header(self) -> bytes:
        """The mode alone."""
        return bytes([self.MODE])

    def encode(
        self, rows: npt.NDArray[np.int32], near: npt.NDArray[np.int32] | None = None
    ) -> bytes:
        """The stream of the rows (n, channels) int32."""
        return encode(rows)

    def decode(
        self, data: bytes | memoryview, count: int, near: npt.NDArray[np.int32] | None = None
    ) -> npt.NDArray[np.int32]:
        """The rows (count, channels) int32 of a stream.

        Raises:
            ValueError: the stream is damaged, or holds another number of rows.
        """
        return decode(data, count, self.channels)
