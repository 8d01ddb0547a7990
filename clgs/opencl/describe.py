"""Describe the machine's OpenCL devices in plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pyopencl as cl

from clgs.opencl.choose import choose_device, list_devices

KINDS = (
    (cl.device_type.CPU, "CPU"),
    (cl.device_type.GPU, "GPU"),
    (cl.device_type.ACCELERATOR, "accelerator"),
)


@dataclass(frozen=True)
class DeviceInfo:
    """One device; sizes in bytes, ``vector_width`` in float32 lanes."""

    index: int
    chosen: bool
    platform: str
    name: str
    type: str
    driver: str
    compute_units: int
    memory: int
    max_work_group: int
    local_memory: int
    vector_width: int


def describe_devices() -> list[DeviceInfo]:
    """Every usable device in the order of its index, with the one marked that clgs would choose.

    Raises:
        DeviceError: there is no device, or PYOPENCL_CTX names none.
    """
    chosen = choose_device()
    return [_describe(i, device, device == chosen) for i, device in enumerate(list_devices())]


def _describe(index: int, device: Any, chosen: bool) -> DeviceInfo:
    return DeviceInfo(
        index=index,
        chosen=chosen,
        platform=device.platform.name.strip(),
        name=device.name.strip(),
        type=next((kind for bit, kind in KINDS if device.type & bit), "other"),
        driver=device.driver_version.strip(),
        compute_units=device.max_compute_units,
        memory=device.global_mem_size,
        max_work_group=device.max_work_group_size,
        local_memory=device.local_mem_size,
        vector_width=device.native_vector_width_float,
    )
