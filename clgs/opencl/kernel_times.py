"""How long kernels take by the device's own clock."""

from __future__ import annotations

from collections import defaultdict

import pyopencl as cl

NANOSECOND = 1e-6
"""Of a millisecond."""


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
            found[kernel] += NANOSECOND * (event.profile.end - event.profile.start)
        self._events.clear()
        return dict(found)
