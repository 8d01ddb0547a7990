"""How often the host waits for a device, and how long."""

from __future__ import annotations

import time
from typing import Any

import pyopencl as cl


class Waits:
    """Waits of the host for a device.

    count: of those that had to wait; seconds: of the host's processor, which some drivers keep
    busy meanwhile.
    """

    def __init__(self) -> None:
        self.count = 0
        self.seconds = 0.0

    def wait(self, event: Any) -> None:
        """Wait for ``event``; raises what the driver says if its command failed."""
        waiting = not is_complete(event)
        start = time.thread_time()
        event.wait()
        if waiting:
            self.seconds += time.thread_time() - start
            self.count += 1


def is_complete(event: Any) -> bool:
    """Whether a command has ended, well or not."""
    status: int = event.command_execution_status
    return status <= cl.command_execution_status.COMPLETE
