"""Times: of stages by the wall clock, of kernels by the device's clock, of waits by the host's."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any

import pyopencl as cl

from clgs.opencl.lost import tells_of_loss

MILLISECONDS = 1e-6
"""Milliseconds of a nanosecond."""


class Profile:
    """Collects seconds by name while ``enabled``; costs nothing otherwise."""

    def __init__(self) -> None:
        self.enabled = False
        self.seconds: dict[str, list[float]] = {}

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        """Record the wall time of the enclosed block under ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds.setdefault(name, []).append(time.perf_counter() - start)

    def clear(self) -> None:
        """Forget all records."""
        self.seconds.clear()

    def rows(self) -> list[tuple[str, int, float, float]]:
        """(name, calls, median milliseconds, total seconds), in order of first appearance."""
        return [
            (name, len(values), 1e3 * median(values), sum(values))
            for name, values in self.seconds.items()
        ]


class KernelTimes:
    """The kernels that ran on a queue that takes their times."""

    def __init__(self) -> None:
        self._events: list[tuple[str, cl.Event]] = []

    def add(self, kernel: str, event: cl.Event) -> None:
        """A launch of ``kernel``, ``event``."""
        self._events.append((kernel, event))

    def take(self) -> dict[str, float]:
        """Milliseconds by kernel, of all launches since the last call; waits for them."""
        found: defaultdict[str, float] = defaultdict(float)
        for kernel, event in self._events:
            event.wait()
            found[kernel] += MILLISECONDS * (event.profile.end - event.profile.start)
        self._events.clear()
        return dict(found)


class Waits:
    """Waits of the host for a device.

    count: of those that had to wait; seconds: of the host's processor, which some drivers keep
    busy meanwhile.
    """

    def __init__(self) -> None:
        self.count = 0
        self.seconds = 0.0

    @tells_of_loss
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
