"""Devices that work on one scene together: they must compute the same bits."""

from __future__ import annotations

from collections.abc import Sequence

from clgs.errors import UsageError
from clgs.opencl.choose import choose_device
from clgs.opencl.device import Device


def open_devices(names: Sequence[str]) -> list[Device]:
    """The devices of these names, in their order; one that is named twice is opened once.

    Raises:
        DeviceError, UsageError: as of :func:`clgs.opencl.choose.choose_device`, and of
            :func:`check_together`.
    """
    chosen = [choose_device(name, "--devices") for name in names]
    opened = {each: Device(cl_device=each) for each in dict.fromkeys(chosen)}
    devices = [opened[each] for each in chosen]
    check_together(devices)
    return devices


def check_together(devices: Sequence[Device]) -> None:
    """Raise UsageError if two of the devices are of different kinds."""
    for device in devices:
        if device.kind != devices[0].kind:
            raise UsageError(
                f"devices: {devices[0].name} ({devices[0].kind}) and {device.name} ({device.kind}) "
                "do not compute the same bits; name some that `clgs devices` marks alike"
            )
