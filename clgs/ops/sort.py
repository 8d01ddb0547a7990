"""Stable radix sort of 32-bit keys with a 32-bit value each.

Least significant digit first; digits of up to 11 bits on a CPU and 8 bits on a GPU. The result does
not depend on how the keys are split into chunks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import chunk_count
from clgs.shapes import Shapes

KEY_BITS = 32
DIGIT_BITS = {"cpu": 11, "gpu": 8}
GROUP_SIZE = {"cpu": 1, "gpu": 256}
SHORTEST_CHUNK = {"cpu": 32768, "gpu": 2048}
MOST_CHUNKS = {"cpu": 32, "gpu": 128}
"""Of :func:`by_key`; every chunk adds up the counts of all, so they are few."""

MAX_WIDTH = 16
"""Bits of a digit of :func:`chosen` on a CPU, at most: two digits are a key."""


def by_key(
    device: Device, keys: DeviceArray, values: DeviceArray, bits: int = KEY_BITS
) -> tuple[DeviceArray, DeviceArray]:
    """Keys (n,) uint32 in ascending order of their low ``bits`` bits, and their values (n,) int32.

    Equal keys keep their order. The inputs stay as they are.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype, or bits is not in 0..32.
    """
    shapes = Shapes()
    shapes.check("keys", keys, "n", np.uint32)
    shapes.check("values", values, "n", np.int32)
    if not 0 <= bits <= KEY_BITS:
        raise ValueError(f"bits: {bits}, expected 0..{KEY_BITS}")
    if device.specialisation == "gpu" and bits > 0:
        return _by_groups(device, keys, values, bits)
    for shift, width in digits(bits, DIGIT_BITS[device.specialisation]):
        keys, values = _pass(device, keys, values, shift, width)
    return keys, values


@dataclass(frozen=True)
class Order:
    """``index`` (n,) int32: the ``count`` (1,) int32 chosen items in ascending order come first.

    What follows them means nothing.
    """

    index: DeviceArray
    count: DeviceArray


def chosen(device: Device, keys: DeviceArray, choice: DeviceArray) -> Order:
    """Order of the items with ``choice`` (n,) int32 > 0 by their keys (n,) uint32 < 2^32 - 1.

    Ties by index. Nothing waits for the device: on a CPU the passes are planned there, from the
    range of the chosen keys.

    Raises:
        ValueError, TypeError: an array has the wrong shape or dtype.
    """
    shapes = Shapes()
    shapes.check("keys", keys, "n", np.uint32)
    shapes.check("choice", choice, "n", np.int32)
    if device.specialisation == "gpu":
        return _chosen_by_groups(device, keys, choice)
    return _chosen_by_plan(device, keys, choice)


def _chosen_by_groups(device: Device, keys: DeviceArray, choice: DeviceArray) -> Order:
    """A launch that counts the first digit of the chosen, then one for each digit."""
    plan = _GroupPlan.of(device, len(keys), KEY_BITS)
    items = keys, choice, *plan.items, *plan.digits
    device.run(device.kernel("sort/chosen", "sort_count_chosen"), *plan.grid, *items)
    end = device.empty((1,), np.int32)
    keys, index = _like(device, keys)
    first = device.kernel("sort/chosen", "sort_place_chosen")
    device.run(first, *plan.grid, *items, end, keys, index)
    place = device.kernel("sort/chosen", "sort_place_next")
    for number in range(1, plan.passes):
        out = _like(device, keys)
        device.run(place, *plan.grid, keys, index, *plan.digits, end, np.int32(number), *out)
        keys, index = out
    return Order(index, end)


def _chosen_by_plan(device: Device, keys: DeviceArray, choice: DeviceArray) -> Order:
    count, parts = np.int32(len(keys)), chunk_count(device)
    chunks = np.int32(parts)
    plan = device.empty((4,), np.int32)
    ranges = device.empty((parts, 2), np.uint32)
    counters = device.empty((parts, 2**MAX_WIDTH), np.int32)
    pairs, index = device.empty((len(keys), 2), np.uint32), device.empty(keys.shape, np.int32)
    all_chunks, one = ((parts,), (1,)), ((1,), (1,))
    items = keys, choice, count
    starts = device.kernel("sort/chosen", "sort_starts")
    device.run(device.kernel("sort/chosen", "sort_range"), *all_chunks, *items, ranges)
    planned = *items, ranges, plan, counters
    device.run(device.kernel("sort/chosen", "sort_count_chosen"), *all_chunks, *planned)
    device.run(starts, *one, counters, chunks, plan)
    placed = *items, plan, counters, pairs
    device.run(device.kernel("sort/chosen", "sort_place_chosen"), *all_chunks, *placed)
    counted = pairs, plan, counters
    device.run(device.kernel("sort/chosen", "sort_count_pairs"), *all_chunks, *counted)
    device.run(starts, *one, counters, chunks, plan)
    device.run(device.kernel("sort/chosen", "sort_place_pairs"), *all_chunks, *counted, index)
    return Order(index, DeviceArray(plan.buffer, (1,), plan.dtype))


def digits(bits: int, widest: int) -> list[tuple[int, int]]:
    """(shift, width) of the fewest digits of equal width that cover the low ``bits`` bits."""
    if bits == 0:
        return []
    passes = -(-bits // widest)
    width = -(-bits // passes)
    return [(shift, min(width, bits - shift)) for shift in range(0, bits, width)]


def _pass(
    device: Device, keys: DeviceArray, values: DeviceArray, shift: int, width: int
) -> tuple[DeviceArray, DeviceArray]:
    """One digit on a CPU: a work-item counts and places a chunk of the keys."""
    count, chunks = len(keys), _chunks(len(keys), "cpu")
    size = (chunks,), (1,)
    plan = np.int32(count), np.int32(-(-count // chunks))
    digit = np.int32(shift), np.uint32(2**width - 1)
    histogram = device.empty((chunks * 2 ** DIGIT_BITS["cpu"],), np.int32)
    out = _like(device, keys)
    device.run(
        device.kernel("sort/by_key", "sort_histogram"), *size, keys, *plan, *digit, histogram
    )
    scatter = device.kernel("sort/by_key", "sort_scatter")
    device.run(scatter, *size, keys, values, *plan, *digit, histogram, *out)
    return out


def _by_groups(
    device: Device, keys: DeviceArray, values: DeviceArray, bits: int
) -> tuple[DeviceArray, DeviceArray]:
    """On a GPU: a launch that counts the first digit, then one for each digit."""
    plan = _GroupPlan.of(device, len(keys), bits)
    sizes = *plan.items, *plan.digits
    device.run(device.kernel("sort/by_key", "sort_histogram"), *plan.grid, keys, *sizes)
    place = device.kernel("sort/by_key", "sort_scatter")
    for number in range(plan.passes):
        out = _like(device, keys)
        device.run(place, *plan.grid, keys, values, *sizes, np.int32(number), *out)
        keys, values = out
    return keys, values


@dataclass(frozen=True)
class _GroupPlan:
    """How work-groups sort: launch size, and arguments of the kernels.

    items: their number, and that of a chunk; digits: bits of a digit, of all, and room for the
    histograms of all passes.
    """

    passes: int
    grid: tuple[tuple[int], tuple[int]]
    items: tuple[np.int32, np.int32]
    digits: tuple[np.int32, np.int32, DeviceArray]

    @classmethod
    def of(cls, device: Device, count: int, bits: int) -> _GroupPlan:
        """For ``count`` items and at least one bit."""
        group, chunks, plan = (
            GROUP_SIZE["gpu"],
            _chunks(count, "gpu"),
            digits(bits, DIGIT_BITS["gpu"]),
        )
        histograms = device.empty((len(plan), chunks, 2 ** DIGIT_BITS["gpu"]), np.int32)
        return cls(
            len(plan),
            ((chunks * group,), (group,)),
            (np.int32(count), np.int32(max(1, -(-count // chunks)))),
            (np.int32(plan[0][1]), np.int32(bits), histograms),
        )


def _chunks(count: int, form: str) -> int:
    return max(1, min(MOST_CHUNKS[form], count // SHORTEST_CHUNK[form]))


def _like(device: Device, keys: DeviceArray) -> tuple[DeviceArray, DeviceArray]:
    """Room for as many keys and values."""
    return device.empty(keys.shape, np.uint32), device.empty(keys.shape, np.int32)
