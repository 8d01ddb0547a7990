"""Where a figure was measured: machine, device and versions, in plain data."""

from __future__ import annotations

import shlex
import sys

from clgs.machine import host_facts
from clgs.opencl.device import Device


def machine_facts(device: Device) -> dict[str, object]:
    """Names and versions of what made a figure; no host names and no times."""
    return {"device": device_facts(device), **host_facts()}


def command_line() -> str:
    """The command that runs, to be run again."""
    return shlex.join(["clgs", *sys.argv[1:]])


def device_facts(device: Device) -> dict[str, object]:
    """What identifies an OpenCL device and the form of the kernels on it."""
    described = device.cl_device
    return {
        "name": device.name,
        "platform": described.platform.name.strip(),
        "version": described.version.strip(),
        "driver": described.driver_version.strip(),
        "compute_units": described.max_compute_units,
        "native_vector_width": described.native_vector_width_float,
        "specialisation": device.specialisation,
    }
