"""Stable radix sort of 32-bit keys with a 32-bit value each.

Least significant digit first; digits of up to 11 bits on a CPU and 8 bits on a GPU. The result does
not depend on how the keys are split into chunks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import LaunchSizes, chunk_count
from clgs.opencl.kernel import Argument
from clgs.opencl.programs import SCAN_GROUP_SIZE
from clgs.shapes import Shapes

KEY_BITS = 32
DIGIT_BITS = {"cpu": 11, "gpu": SCAN_GROUP_SIZE.bit_length() - 1}
"""On a GPU a work-item of a group counts one value of a digit."""

SHORTEST_CHUNK = {"cpu": 32768, "gpu": 2048}
MOST_CHUNKS = {"cpu": 32, "gpu": 128}
"""How :func:`by_key` cuts keys into chunks: few, as every chunk adds up the counts of all."""

MAX_WIDTH = 16
"""Bits of a digit of :func:`chosen` on a CPU, at most: two digits are a key."""

PLAN_SIZE = 3
"""Numbers of the plan that the kernels of :func:`chosen` make on a CPU."""


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
    chunks = chunk_count(device)
    plan = device.empty((PLAN_SIZE,), np.int32)
    ranges = device.empty((chunks, 2), np.uint32)
    counters = device.empty((chunks, 2**MAX_WIDTH), np.int32)
    pairs, index = device.empty((len(keys), 2), np.uint32), device.empty(keys.shape, np.int32)
    chosen: dict[str, Argument] = {
        "keys": keys,
        "chosen": choice,
        "count": np.int32(len(keys)),
    }

    def run(name: str, items: int, /, **arguments: Argument) -> None:
        sizes = {"MAX_WIDTH": MAX_WIDTH, "PLAN_SIZE": PLAN_SIZE}
        device.run(device.kernel("sort/chosen", name, **sizes), (items,), (1,), **arguments)

    run("sort_range", chunks, **chosen, ranges=ranges)
    run("sort_count_chosen", chunks, **chosen, ranges=ranges, plan=plan, counters=counters)
    run("sort_starts", 1, counters=counters, chunks=np.int32(chunks), plan=plan)
    run("sort_place_chosen", chunks, **chosen, plan=plan, places=counters, pairs=pairs)
    run("sort_count_pairs", chunks, pairs=pairs, plan=plan, counters=counters)
    run("sort_starts", 1, counters=counters, chunks=np.int32(chunks), plan=plan)
    run("sort_place_pairs", chunks, pairs=pairs, plan=plan, places=counters, order=index)
    return Order(index, plan.first(1))


def _chosen_by_groups(device: Device, keys: DeviceArray, choice: DeviceArray) -> Order:
    """A launch that counts the first digit of the chosen, then one for each digit."""
    groups = _Groups.of(device, len(keys), KEY_BITS)
    chosen = {"keys": keys, "chosen": choice, **groups.items, **groups.digits}
    device.run(device.kernel("sort/chosen", "sort_count_chosen"), *groups.grid, **chosen)
    count = device.empty((1,), np.int32)
    keys, index = _like(device, keys)
    device.run(
        device.kernel("sort/chosen", "sort_place_chosen"),
        *groups.grid,
        **chosen,
        chosen_count=count,
        sorted_keys=keys,
        order=index,
    )
    for number in range(1, groups.passes):
        sorted_keys, order = _like(device, keys)
        device.run(
            device.kernel("sort/chosen", "sort_place_next"),
            *groups.grid,
            keys=keys,
            values=index,
            **groups.digits,
            chosen_count=count,
            number=np.int32(number),
            sorted_keys=sorted_keys,
            order=order,
        )
        keys, index = sorted_keys, order
    return Order(index, count)


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
    count, chunks, bits = len(keys), _chunks(len(keys), "cpu"), DIGIT_BITS["cpu"]
    sorted_keys, sorted_values = _like(device, keys)
    digit: dict[str, Argument] = {
        "keys": keys,
        "count": np.int32(count),
        "chunk": np.int32(-(-count // chunks)),
        "shift": np.int32(shift),
        "mask": np.uint32(2**width - 1),
        "histogram": device.empty((chunks * 2**bits,), np.int32),
    }
    histogram = device.kernel("sort/by_key", "sort_histogram", DIGIT_BITS=bits)
    device.run(histogram, (chunks,), (1,), **digit)
    device.run(
        device.kernel("sort/by_key", "sort_scatter", DIGIT_BITS=bits),
        *((chunks,), (1,)),
        **digit,
        values=values,
        sorted_keys=sorted_keys,
        sorted_values=sorted_values,
    )
    return sorted_keys, sorted_values


def _by_groups(
    device: Device, keys: DeviceArray, values: DeviceArray, bits: int
) -> tuple[DeviceArray, DeviceArray]:
    """On a GPU: a launch that counts the first digit, then one for each digit."""
    groups = _Groups.of(device, len(keys), bits)
    sizes = {**groups.items, **groups.digits}
    device.run(device.kernel("sort/by_key", "sort_histogram"), *groups.grid, keys=keys, **sizes)
    for number in range(groups.passes):
        sorted_keys, sorted_values = _like(device, keys)
        device.run(
            device.kernel("sort/by_key", "sort_scatter"),
            *groups.grid,
            keys=keys,
            values=values,
            **sizes,
            number=np.int32(number),
            sorted_keys=sorted_keys,
            sorted_values=sorted_values,
        )
        keys, values = sorted_keys, sorted_values
    return keys, values


@dataclass(frozen=True)
class _Groups:
    """How work-groups sort: the passes, the launch size, and arguments of the kernels.

    items: how many there are, and how many a chunk has; digits: the bits of a digit and of all, and
    room for the histograms of all passes.
    """

    passes: int
    grid: LaunchSizes
    items: dict[str, Argument]
    digits: dict[str, Argument]

    @classmethod
    def of(cls, device: Device, count: int, bits: int) -> _Groups:
        """Plan the sort of ``count`` items by at least one bit."""
        chunks, passes = _chunks(count, "gpu"), digits(bits, DIGIT_BITS["gpu"])
        histograms = device.empty((len(passes), chunks, 2 ** DIGIT_BITS["gpu"]), np.int32)
        return cls(
            len(passes),
            ((chunks * SCAN_GROUP_SIZE,), (SCAN_GROUP_SIZE,)),
            {"count": np.int32(count), "chunk": np.int32(max(1, -(-count // chunks)))},
            {"width": np.int32(passes[0][1]), "bits": np.int32(bits), "histograms": histograms},
        )


def _chunks(count: int, form: str) -> int:
    return max(1, min(MOST_CHUNKS[form], count // SHORTEST_CHUNK[form]))


def _like(device: Device, keys: DeviceArray) -> tuple[DeviceArray, DeviceArray]:
    """Room for as many keys and values."""
    return device.empty(keys.shape, np.uint32), device.empty(keys.shape, np.int32)
