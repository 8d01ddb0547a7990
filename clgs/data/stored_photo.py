"""Photos as bytes: each in memory once, up to a number of bytes for all; beyond it, on the disk."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock, RLock

import numpy as np
import numpy.typing as npt

from clgs.data.images import Pixels, box_downscale
from clgs.errors import DataError

Planes = npt.NDArray[np.uint8]
Color = tuple[float, float, float]

DEFAULT_MEMORY = 1024 * 2**20
"""Bytes of decoded photos that a data set keeps unless another number is asked for."""


class PhotoMemory:
    """The bytes that the photos of one data set may take; photos share it."""

    def __init__(self, limit: int = DEFAULT_MEMORY) -> None:
        """``limit`` is in bytes."""
        self._free = limit
        self._lock = Lock()

    def take(self, nbytes: int) -> bool:
        """Whether there is room for ``nbytes`` more; if so, they count from now on.

        A negative number gives bytes back.
        """
        with self._lock:
            if nbytes > max(self._free, 0):
                return False
            self._free -= nbytes
            return True


@dataclass(frozen=True)
class _Composited:
    """planes (3, H, W) uint8 over ``color``; opaque: the photo has no alpha, so color is all."""

    planes: Planes
    color: Color
    opaque: bool

    def holds(self, color: Color) -> bool:
        return self.opaque or self.color == color


class StoredPhoto:
    """A photo that can be read at any time; its bytes stay in memory if :meth:`keep` found room.

    They stay in one form: as read, or, once :meth:`planes` is called with ``final``, over that
    color. Several threads may read.
    """

    def __init__(
        self, read: Callable[[], Pixels], memory: PhotoMemory, name: str = "photo"
    ) -> None:
        """``read`` gives the same pixels each time; ``name`` is for messages."""
        self._read, self._memory, self._name = read, memory, name
        self._kept: Pixels | _Composited | None = None
        self._reduced: tuple[int, Pixels] | None = None
        self._checksum: int | None = None
        self._lock = RLock()

    @classmethod
    def of(cls, pixels: Pixels) -> StoredPhoto:
        """A photo that is in memory anyway."""
        return cls(lambda: pixels, PhotoMemory(0))

    def keep(self) -> None:
        """Read the photo, and keep it if there is room.

        Raises:
            DataError: it is damaged, or no longer what it was.
        """
        pixels = self.pixels()
        with self._lock:
            if self._kept is None and self._memory.take(_size(pixels)):
                self._kept = pixels

    def pixels(self) -> Pixels:
        """The photo as it was read, from memory or from the disk.

        Raises:
            DataError: it is damaged, or no longer what it was.
        """
        kept = self._kept
        if isinstance(kept, Pixels):
            return kept
        if isinstance(kept, _Composited) and kept.opaque:
            return Pixels(np.ascontiguousarray(kept.planes.transpose(1, 2, 0)), None)
        pixels = self._read()
        checksum = zlib.crc32(np.ascontiguousarray(pixels.color).data)
        if self._checksum not in (None, checksum):
            raise DataError(f"{self._name}: changed while it was in use; restore it")
        self._checksum = checksum
        return pixels

    def checksum(self) -> int:
        """CRC-32 of the colors as read, (H, W, 3) in order."""
        if self._checksum is None:
            self.pixels()
        assert self._checksum is not None
        return self._checksum

    def reduced(self, factor: int) -> Pixels:
        """The photo ``factor`` times smaller, by box means; kept until another factor is wanted."""
        if factor == 1:
            return self.pixels()
        with self._lock:
            if self._reduced is not None and self._reduced[0] == factor:
                return self._reduced[1]
            self._forget_reduced()
            small = box_downscale(self.pixels(), factor)
            if self._kept is not None and self._memory.take(_size(small)):
                self._reduced = factor, small
            return small

    def _forget_reduced(self) -> None:
        if self._reduced is not None:
            self._memory.take(-_size(self._reduced[1]))
            self._reduced = None

    def planes(self, color: Color, factor: int = 1, final: bool = False) -> Planes:
        """The photo over ``color`` in [0, 1] as (3, H, W) uint8, ``factor`` times smaller.

        ``final``: if the factor is 1, from now on only this form is kept in memory.
        """
        kept = self._kept
        if factor == 1 and isinstance(kept, _Composited) and kept.holds(color):
            return kept.planes
        pixels = self.reduced(factor)
        planes = composite(pixels, color)
        if final and factor == 1:
            with self._lock:
                self._forget_reduced()
                if self._kept is pixels:
                    self._kept = _Composited(planes, color, pixels.alpha is None)
                    self._memory.take(planes.nbytes - _size(pixels))
        return planes

    def has(self, color: Color | None, factor: int) -> bool:
        """Whether :meth:`planes`, or :meth:`reduced` if ``color`` is None, has nothing to do."""
        kept, reduced = self._kept, self._reduced
        if color is not None:
            return factor == 1 and isinstance(kept, _Composited) and kept.holds(color)
        if factor > 1:
            return reduced is not None and reduced[0] == factor
        return isinstance(kept, Pixels)


def composite(pixels: Pixels, color: Color) -> Planes:
    """The photo over a color in [0, 1], as (3, H, W) uint8 planes."""
    source = pixels.color.transpose(2, 0, 1)
    if pixels.alpha is None:
        return np.ascontiguousarray(source)
    planes = np.empty(source.shape, np.uint8)
    high = pixels.alpha.astype(np.uint16) << 8
    alpha = np.arange(256, dtype=np.float32)[:, None] / np.float32(255)
    tables, level = {}, np.arange(256, dtype=np.uint8)
    for value in set(color):  # what every level becomes, at index 256 alpha + level
        mixed = np.rint(level * alpha + np.float32(value) * np.float32(255) * (1 - alpha))
        tables[value] = mixed.reshape(-1).astype(np.uint8)
    for plane, channel, value in zip(planes, source, color, strict=True):
        np.take(tables[value], high | channel, out=plane, mode="clip")
    return planes


def _size(pixels: Pixels) -> int:
    return pixels.color.nbytes + (0 if pixels.alpha is None else pixels.alpha.nbytes)
