"""What a device reaches at most: bytes copied and float32 operations per second, measured."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from clgs.lab import limit_kernels as limits
from clgs.opencl.device import Device

COPY_BYTES = 128 << 20
"""Of one array: well beyond the caches of today's processors."""
EMULATED_BYTES = 1 << 16
LEAST_SECONDS = 0.02
REPEATS = 7
GROUPS_A_UNIT = {"cpu": 4, "gpu": 64}


@dataclass(frozen=True)
class DeviceLimits:
    """Measured rates of a device.

    A copied byte counts twice (read, written), a fused multiply-add as two operations.
    """

    bytes_per_second: float
    flops_per_second: float


def measure_limits(device: Device) -> DeviceLimits:
    """Best of some runs of a copy between two large arrays and of chains of FMAs in registers."""
    return DeviceLimits(_bytes_per_second(device), _flops_per_second(device))


def _best_seconds(device: Device, work: Callable[[], object], repeats: int = REPEATS) -> float:
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        work()
        device.finish()
        seconds.append(time.perf_counter() - start)
    return min(seconds[1:])


def _bytes_per_second(device: Device) -> float:
    largest = EMULATED_BYTES if device.is_emulator else COPY_BYTES
    count: int = min(largest, device.cl_device.global_mem_size // 16) // 4
    source, target = device.zeros((count,)), device.zeros((count,))
    return 8 * count / _best_seconds(device, lambda: limits.copy(device, source, target))


def _flops_per_second(device: Device) -> float:
    """Of chains that grow longer until they take LEAST_SECONDS."""
    groups = 1 if device.is_emulator else device.cl_device.max_compute_units
    groups *= GROUPS_A_UNIT[device.specialisation]
    steps = 16
    while not device.is_emulator and _fma_seconds(device, groups, steps, 2) < LEAST_SECONDS:
        steps *= 4
    lanes = len(limits.fma(device, groups, steps))
    return 2 * limits.CHAINS * steps * lanes / _fma_seconds(device, groups, steps)


def _fma_seconds(device: Device, groups: int, steps: int, repeats: int = REPEATS) -> float:
    return _best_seconds(device, lambda: limits.fma(device, groups, steps), repeats)
