"""A fork of a process that has opened a device says that it cannot use it, and does not hang."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys
import numpy as np
from clgs.errors import DeviceError
from clgs.opencl.device import Device
early = sys.argv[1] == "early"
device = Device() if early else None
child = os.fork()
if child == 0:
    for use in (lambda: (device or Device()).upload(np.ones(3)), Device):
        try:
            use()
            print("works", flush=True)
        except DeviceError as error:
            print(error, flush=True)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
device = device or Device()
assert device.download(device.upload(np.ones(3))).sum() == 3
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no fork")
@pytest.mark.parametrize("when", ["early", "late"])
def test_a_fork_uses_no_device_of_its_parent(when):
    command = [sys.executable, "-c", PROGRAM, when]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 2
    for line in lines:
        assert line == "works" if when == "late" else "forked" in line and '"spawn"' in line
