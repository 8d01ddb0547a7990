"""Commands of the laboratory, and the --device option of those that run on every device."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

from clgs.cli.tell import tell

if TYPE_CHECKING:
    from clgs.opencl.device import Device


def add_device_option(parser: argparse.ArgumentParser) -> None:
    """Add --device."""
    parser.add_argument(
        "--device",
        help="number or part of the name, see `clgs devices` (default: the one that PYOPENCL_CTX "
        "names, else every device but emulators)",
    )


def open_devices(name: str | None) -> Iterator[tuple[str, Device]]:
    """Number and device of each that was asked for; standard error names those left out.

    Raises:
        DeviceError: there is no device, or none has that name.
    """
    from clgs.opencl.choose import choose_device, is_emulator, survey
    from clgs.opencl.device import Device

    chosen = choose_device(name)
    devices, skipped = survey()
    if name or os.environ.get("PYOPENCL_CTX"):
        yield str(devices.index(chosen)), Device(name)
        return
    for index, device in enumerate(devices):
        if is_emulator(device) and device != chosen:
            skipped.append(f"{device.name.strip()}: an emulator; name it with --device {index}")
    for line in skipped:
        tell(f"clgs: skipped: {line}")
    for index, device in enumerate(devices):
        if not is_emulator(device) or device == chosen:
            yield str(index), Device(str(index))
