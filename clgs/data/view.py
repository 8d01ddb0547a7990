"""A photo with its camera, as training and scoring take it, and where its bytes are.

Photos are in memory once, up to a number of bytes for all; beyond it, on the disk. Large photos as
they are used are kept in the user's cache folder, because decoding them takes long.
"""

from __future__ import annotations

import hashlib
import io
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from threading import Lock, RLock

import numpy as np
import numpy.typing as npt
import PIL
from PIL import Image

from clgs.data.images import Pixels, box_downscale, check_image, read_image
from clgs.data.masks import Mask, StoredMask
from clgs.data.reduction import IGNORE, OBJECT
from clgs.errors import ClgsError, DataError
from clgs.files import atomic_write, cache_folder, make_folder
from clgs.scene.camera import Camera

FOLDER = "photos"

LEAST_PIXELS, LEAST_REDUCTION = 4_000_000, 4
"""Photos of fewer pixels, or of which more than a fourth stay, are decoded every time."""

LIMIT = 2**30
"""Bytes of all files together."""

VERSION = "1"
"""Another one if photos are reduced or undistorted in another way."""


def is_worth_keeping(before: tuple[int, int], after: tuple[int, int]) -> bool:
    """Whether a photo that is reduced from one size (width, height) to another is kept."""
    pixels = before[0] * before[1]
    return pixels >= max(LEAST_PIXELS, LEAST_REDUCTION * after[0] * after[1])


def kept_pixels(files: list[Path], settings: object, make: Callable[[], Pixels]) -> Pixels:
    """What ``make`` gives, from the cache if it is there.

    Args:
        files: that the pixels are made of.
        settings: how they are made; its ``repr`` says all that matters.
        make: decodes and reduces a photo.

    Raises:
        DataError: as of ``make``. A cache that cannot be read or written is no error.
    """
    key = hashlib.blake2b(f"{VERSION} {PIL.__version__} {settings!r}".encode(), digest_size=20)
    try:
        for file in files:
            key.update(hashlib.blake2b(file.read_bytes()).digest())
    except OSError:
        return make()  # which says what is wrong
    kept = cache_folder() / FOLDER / f"{key.hexdigest()}.png"
    with suppress(ClgsError, OSError):
        check_image(kept)
        found = read_image(kept)
        os.utime(kept)
        return found
    pixels, buffer = make(), io.BytesIO()
    if pixels.alpha is not None and pixels.alpha.min() == 255:
        return pixels  # it would come back without alpha
    Image.fromarray(pixels.channels).save(buffer, "PNG", compress_level=1)
    with suppress(ClgsError, OSError):
        make_folder(kept.parent)
        atomic_write(kept, buffer.getvalue())
        forget_oldest(kept.parent)
    return pixels


def forget_oldest(folder: Path) -> None:
    """Remove the files that were not used for longest, until the others take at most LIMIT."""
    files = sorted((file.stat().st_mtime, file.stat().st_size, file) for file in folder.iterdir())
    excess = sum(size for _, size, _ in files) - LIMIT
    for _, size, file in files:
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size


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


@dataclass(frozen=True)
class View:
    """One photo, undistorted and reduced, and its camera in scene units.

    ``photo.pixels()`` has the pixels: color (H, W, 3) uint8, and alpha (H, W) uint8 or None; mask
    says which of them are of use, all if it is None. If ``masks`` is "ignore", the others are not
    compared with renders; if it is "object", the photo's alpha is 0 there and all are compared.
    """

    name: str
    camera: Camera
    photo: StoredPhoto
    mask: StoredMask | None = None
    masks: str = IGNORE

    def used(self, factor: int = 1) -> Mask | None:
        """The pixels to compare, (H, W) uint8 of 0 and 1, ``factor`` times smaller; None: all.

        Raises:
            DataError: it is damaged.
        """
        if self.mask is None or self.masks == OBJECT:
            return None
        return self.mask.used(factor)


def with_photos(views: Sequence[View], color: Color) -> Iterator[tuple[View, Planes]]:
    """Each view with its photo over ``color``, (3, H, W) uint8.

    Each is read while the one before it is in use, and none is kept.

    Raises:
        DataError: a photo is damaged.
    """
    with ThreadPoolExecutor(1, "photos") as pool:
        coming = (pool.submit(view.photo.planes, color) for view in views)
        waiting = next(coming, None)
        for view, following in zip(views, chain(coming, [None]), strict=False):
            assert waiting is not None
            planes, waiting = waiting.result(), following
            yield view, planes
