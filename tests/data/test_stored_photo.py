"""Photos stay in memory once, up to a bound, and are the same from memory and from the disk."""

import numpy as np
import pytest

from clgs.data.images import Pixels, box_downscale
from clgs.data.view import PhotoMemory, StoredPhoto, composite
from clgs.errors import DataError

WHITE = (1.0, 1.0, 1.0)
SIZE = 12 * 10 * 4


@pytest.fixture
def pixels(rng):
    color = rng.integers(0, 256, (12, 10, 3)).astype(np.uint8)
    return Pixels(color, rng.integers(0, 256, (12, 10)).astype(np.uint8))


class Disk:
    """Pixels, and how often they were read."""

    def __init__(self, pixels: Pixels) -> None:
        self.pixels, self.reads = pixels, 0

    def read(self) -> Pixels:
        self.reads += 1
        return self.pixels


def free(memory: PhotoMemory) -> int:
    """The free bytes, found by bisection."""
    room = 0
    for step in (1 << bit for bit in reversed(range(20))):
        if memory.take(room + step):
            memory.take(-(room + step))
            room += step
    return room


def test_composite():
    image = np.full((2, 3, 3), 200, np.uint8)
    alpha = np.array([[0, 255, 51], [0, 255, 102]], np.uint8)
    planes = composite(Pixels(image, alpha), (1.0, 0.0, 0.5))
    assert planes.shape == (3, 2, 3)
    assert planes.flags.c_contiguous
    assert planes[:, 0, 0].tolist() == [255, 0, 128]
    assert planes[:, 0, 1].tolist() == [200, 200, 200]
    assert planes[:, 0, 2].tolist() == [244, 40, 142]
    assert composite(Pixels(image, None), (0, 0, 0))[0].min() == 200


def test_composite_is_the_formula_in_float32():
    every = np.arange(65536)
    level, alpha = (every % 256).astype(np.uint8), (every // 256).astype(np.uint8)
    pixels = Pixels(np.stack([level] * 3, -1)[None], alpha[None])
    color = (1.0, 0.0, 0.3)
    share = alpha[:, None] / np.float32(255)
    behind = np.array(color, np.float32) * np.float32(255)
    wanted = np.rint(pixels.color[0] * share + behind * (1 - share)).astype(np.uint8)
    assert np.array_equal(composite(pixels, color)[:, 0].T, wanted)


def test_a_kept_photo_is_read_once_and_is_in_memory_once(pixels):
    disk, memory = Disk(pixels), PhotoMemory(2 * SIZE)
    photo = StoredPhoto(disk.read, memory)
    photo.keep()
    assert free(memory) == SIZE
    planes = photo.planes(WHITE, final=True)
    assert free(memory) == SIZE + SIZE // 4  # alpha is gone
    assert photo.planes(WHITE) is planes
    assert photo.has(WHITE, 1)
    assert disk.reads == 1
    assert np.array_equal(photo.pixels().alpha, pixels.alpha)  # from the disk
    assert np.array_equal(photo.planes((0.0, 0.0, 0.0)), composite(pixels, (0.0, 0.0, 0.0)))
    assert disk.reads == 3


def test_an_opaque_photo_is_never_read_again(pixels):
    disk = Disk(Pixels(pixels.color, None))
    photo = StoredPhoto(disk.read, PhotoMemory())
    photo.keep()
    photo.planes(WHITE, final=True)
    assert photo.planes((0.0, 0.0, 0.0)) is photo.planes(WHITE)
    assert np.array_equal(photo.pixels().color, pixels.color)
    assert disk.reads == 1


def test_what_does_not_fit_is_read_each_time(pixels):
    disk, memory = Disk(pixels), PhotoMemory(SIZE - 1)
    photo = StoredPhoto(disk.read, memory)
    photo.keep()
    for _ in range(2):
        assert np.array_equal(photo.planes(WHITE, final=True), composite(pixels, WHITE))
        assert np.array_equal(photo.reduced(2).color, box_downscale(pixels, 2).color)
    assert disk.reads == 5
    assert free(memory) == SIZE - 1


def test_one_reduced_copy_is_kept(pixels):
    memory = PhotoMemory(2 * SIZE)
    photo = StoredPhoto(Disk(pixels).read, memory)
    photo.keep()
    assert photo.reduced(2) is photo.reduced(2)
    assert free(memory) == SIZE - SIZE // 4
    small = box_downscale(pixels, 4)
    assert np.array_equal(photo.planes(WHITE, 4, final=True), composite(small, WHITE))
    assert free(memory) == SIZE - small.color.nbytes * 4 // 3
    photo.planes(WHITE, final=True)
    assert free(memory) == SIZE + SIZE // 4


def test_a_photo_that_changes_is_refused(pixels):
    disk = Disk(pixels)
    photo = StoredPhoto(disk.read, PhotoMemory(0), "a.png")
    checksum = photo.checksum()
    disk.pixels = Pixels(255 - pixels.color, pixels.alpha)
    with pytest.raises(DataError, match=r"a\.png: changed while it was in use"):
        photo.planes(WHITE)
    assert photo.checksum() == checksum
