"""Descriptors of a photo, and the nearest ones of another photo.

Descriptors are vectors of bytes of one length, as SIFT's (Lowe, Distinctive image features from
scale-invariant keypoints, 2004), so that the nearest one has the largest dot product. Products are
sums of integers below 2^24, exact in any order: results are the same on every device.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import LaunchSizes, by_items

LENGTH = 128
"""Numbers of a descriptor."""

LANES = 16
"""Descriptors of a tile."""

BLOCK_ROWS = 64
"""Descriptors whose nearest ones a job finds; a photo's are padded to a multiple."""

TILE_BITS = 12
"""A key holds the number of a tile in these bits, and a product in those above."""

MAX_DESCRIPTORS = LANES << TILE_BITS
MAX_PRODUCT = 1 << (31 - TILE_BITS)
"""Products are less than this; those of SIFT are 2^18 and a little more."""

GPU_GROUP = 256

Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Descriptors:
    """Descriptors of several photos on the device.

    tiles: (T, LENGTH / 2, LANES, 2) uint8; first, count: of each photo its first tile and
    the number of its descriptors.
    """

    tiles: DeviceArray
    first: list[int]
    count: list[int]


@dataclass(frozen=True)
class Nearest:
    """The nearest descriptors of another photo to those of a photo, (M,) int32 each.

    index: its number; product: their dot product; second: the second largest dot product. The
    product is 0 if the other photo has no descriptor that shares a number above 0.
    """

    index: Ints
    product: Ints
    second: Ints


def upload(device: Device, photos: Sequence[Bytes]) -> Descriptors:
    """Copy the descriptors (M, LENGTH) uint8 of each photo to the device.

    Raises:
        ValueError, TypeError: an array has another shape or dtype, too many descriptors, or one
            that is too long for its products to be exact.
    """
    for number, photo in enumerate(photos):
        _check(f"photos[{number}]", photo)
    blocks = [_blocks(len(photo)) for photo in photos]
    step = BLOCK_ROWS // LANES
    first = [step * sum(blocks[:number]) for number in range(len(photos))]
    pairs = np.empty((step * sum(blocks), LENGTH // 2, LANES), np.uint16)  # of numbers
    for photo, count, tile in zip(photos, blocks, first, strict=True):
        padded = np.zeros((count * BLOCK_ROWS, LENGTH), np.uint8)
        padded[: len(photo)] = photo
        rows = padded.view(np.uint16).reshape(-1, LANES, LENGTH // 2)
        pairs[tile : tile + step * count] = rows.transpose(0, 2, 1)
    uploaded = device.upload(pairs.view(np.uint8).reshape(*pairs.shape, 2))
    return Descriptors(uploaded, first, [len(photo) for photo in photos])


def nearest(
    device: Device, own: Descriptors, others: Descriptors, pairs: Sequence[tuple[int, int]]
) -> list[Nearest]:
    """Find for each pair (a, b) the descriptors of photo b of ``others`` nearest to ``own`` a's.

    Waits for the device. The first of several nearest ones counts.

    Raises:
        IndexError: there is no such photo.
    """
    step = BLOCK_ROWS // LANES
    jobs = [
        (own.first[a] + step * block, others.first[b], step * _blocks(others.count[b]))
        for a, b in pairs
        for block in range(_blocks(own.count[a]))
    ]
    if not jobs:
        none = np.zeros(0, np.int32)
        return [Nearest(none, none, none) for _ in pairs]
    # The build options of the kernel are sizes that it shares with this module.
    sizes = {"LENGTH": LENGTH, "LANES": LANES, "BLOCK_ROWS": BLOCK_ROWS, "TILE_BITS": TILE_BITS}
    grid: LaunchSizes = (len(jobs) * GPU_GROUP,), (GPU_GROUP,)
    if device.specialisation == "cpu":
        grid = by_items(len(jobs), 1)
        # as many sums as registers hold
        wide = device.register_lanes == LANES
        sizes |= {"TILES_AT_ONCE": 2, "ROWS": 8} if wide else {"TILES_AT_ONCE": 1, "ROWS": 4}
    results = [device.empty((len(jobs), BLOCK_ROWS), np.int32) for _ in range(3)]
    index, product, second = results
    device.run(
        device.kernel("match/nearest", "match_nearest", **sizes),
        *grid,
        own=own.tiles,
        others=others.tiles,
        jobs=device.upload(np.array(jobs, np.int32)),
        count=np.int32(len(jobs)),
        nearest=index,
        product=product,
        second=second,
    )
    found, row = [], 0
    host = [device.download(result).reshape(-1) for result in results]
    for a, _ in pairs:
        rows = slice(row, row + own.count[a])
        found.append(Nearest(*(result[rows] for result in host)))
        row += BLOCK_ROWS * _blocks(own.count[a])
    return found


def _blocks(count: int) -> int:
    return -(-count // BLOCK_ROWS)


def _check(name: str, photo: Bytes) -> None:
    if photo.ndim != 2 or photo.shape[1] != LENGTH:
        raise ValueError(f"{name}: shape is {photo.shape}, expected (M, {LENGTH})")
    if photo.dtype != np.uint8:
        raise TypeError(f"{name}: dtype is {photo.dtype}, expected uint8")
    if len(photo) > MAX_DESCRIPTORS:
        raise ValueError(
            f"{name}: {len(photo)} descriptors, at most {MAX_DESCRIPTORS} are compared"
        )
    # Two vectors' product is at most the larger one's square (Cauchy-Schwarz).
    square = np.einsum("ij,ij->i", photo, photo, dtype=np.int64).max(initial=0)
    if square >= MAX_PRODUCT:
        raise ValueError(f"{name}: a descriptor's square is {square}, expected below {MAX_PRODUCT}")
