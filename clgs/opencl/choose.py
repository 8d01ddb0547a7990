"""List the machine's OpenCL devices and choose one."""

from __future__ import annotations

import os
from typing import Any

import pyopencl as cl

from clgs.errors import DeviceError

REMEDY = (
    "install one: on Debian or Ubuntu `apt-get install pocl-opencl-icd`, "
    'elsewhere `pip install "pyopencl[pocl]"`, or a GPU vendor\'s driver'
)


def list_devices() -> list[Any]:
    """Every usable device of every platform; a platform without devices counts as none."""
    devices = []
    for platform in _platforms():
        try:
            devices.extend(platform.get_devices())
        except cl.Error:
            continue
    return [device for device in devices if device.available and device.compiler_available]


def _platforms() -> list[Any]:
    try:
        return list(cl.get_platforms())
    except cl.Error:
        return []


def choose_device(name: str | None = None) -> Any:
    """One device: by ``name``, else by PYOPENCL_CTX, else the first GPU, else the first CPU.

    ``name`` is the number that ``clgs devices`` shows, or a part of the device's or platform's
    name. PYOPENCL_CTX reads as in pyopencl: platform or platform:device, each a number or a part
    of a name. Emulators (Oclgrind) are taken only by name.

    Raises:
        DeviceError: there is no device, or none of that name.
    """
    devices = list_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device found; {REMEDY}")
    if name:
        return _pick(devices, name, f"--device {name}")
    if wanted := os.environ.get("PYOPENCL_CTX"):
        return _by_context(devices, wanted)
    return min(devices, key=_preference)


def _by_context(devices: list[Any], wanted: str) -> Any:
    """The device that PYOPENCL_CTX names; a platform alone stands for its first device."""
    platforms = list(dict.fromkeys(device.platform for device in devices))
    first, _, second = wanted.partition(":")
    platform = _pick(platforms, first or "0", f"PYOPENCL_CTX={wanted}")
    inside = [device for device in devices if device.platform == platform]
    return _pick(inside, second or "0", f"PYOPENCL_CTX={wanted}")


def _pick(choices: list[Any], wanted: str, origin: str) -> Any:
    """One of ``choices`` (devices or platforms) by number or by a part of its name."""
    if wanted.isdigit():
        found = choices[int(wanted) : int(wanted) + 1]
    else:
        found = [choice for choice in choices if wanted.lower() in _full_name(choice).lower()]
    if not found:
        names = ", ".join(f"{i}: {choice.name.strip()}" for i, choice in enumerate(choices))
        raise DeviceError(f"{origin} matches no OpenCL device; available: {names}")
    return found[0]


def _full_name(choice: Any) -> str:
    platform = getattr(choice, "platform", None)
    return f"{choice.name} {platform.name}" if platform is not None else str(choice.name)


def _preference(device: Any) -> int:
    if "oclgrind" in device.platform.name.lower():
        return 3
    return 0 if device.type & cl.device_type.GPU else 1
