"""Attribute rows in chunks: what all chunks share, and each chunk to bytes and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.codec import runlength


@dataclass(frozen=True)
class Model:
    """How chunks of ``channels`` channels are coded; ``header`` is what all of them share."""

    channels: int
    header: bytes = b""

    def encode(self, rows: npt.NDArray[np.int32]) -> bytes:
        """The bytes of one chunk (n, channels) int32; they depend on its rows and on the header."""
        return runlength.encode(rows)

    def decode(self, data: bytes | memoryview, rows: int) -> npt.NDArray[np.int32]:
        """One chunk (rows, channels) int32; the caller has bounded ``rows``.

        Raises:
            ValueError: the chunk is damaged, or holds another number of rows.
        """
        return runlength.decode(data, rows, self.channels)


def fit(values: npt.NDArray[np.int32], level: str, chunk: int) -> Model:
    """The model of ``values`` (rows, channels) int32, cut into chunks of ``chunk`` rows."""
    return Model(values.shape[1])


def read(header: bytes | memoryview, channels: int) -> Model:
    """The model that a shared header describes.

    Raises:
        ValueError: the header is damaged.
    """
    if len(header) > 0:
        raise ValueError(f"{len(header)} bytes of a header that must be empty")
    return Model(channels)
