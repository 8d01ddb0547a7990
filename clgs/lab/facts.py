"""Where a figure was measured: machine, device and versions, in plain data."""

from __future__ import annotations

import platform
import shlex
import sys
from importlib import metadata
from pathlib import Path

from clgs import __version__
from clgs.opencl.device import Device

LIBRARIES = ("numpy", "pyopencl")


def machine_facts(device: Device) -> dict[str, object]:
    """Names and versions of what made a figure; no host names and no times."""
    return {"device": device_facts(device), **host_facts()}


def host_facts() -> dict[str, object]:
    """As :func:`machine_facts`, of what no device took part in."""
    versions = {name: metadata.version(name) for name in LIBRARIES}
    return {
        "processor": _processor(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "versions": {"clgs": __version__, "python": platform.python_version(), **versions},
    }


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


def _processor() -> str:
    """The processor's model, if the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()
