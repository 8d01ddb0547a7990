"""Calls of the driver: timed, and if the device is lost they say what helps.

Times are those of stages by the wall clock, of kernels by the device's clock, of waits by the
host's. A process that was forked from one with an open device has lost it: the driver's threads are
not in the copy, and a call would wait for them for ever.
"""

from __future__ import annotations

import functools
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any, ParamSpec, TypeVar

import pyopencl as cl

from clgs.errors import LOST, DeviceError, LostDeviceError

Given = ParamSpec("Given")
Result = TypeVar("Result")


_opened: list[bool] = []
_forked: list[bool] = []
"""Each has an element if it is so: a device was opened; this is a fork made after that."""


def note_opened() -> None:
    """Note that a device is opened.

    Raises:
        DeviceError: this process is a fork of one that has opened one.
    """
    _refuse_fork()
    if not _opened:
        _opened.append(True)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=lambda: _forked.append(True))


def _refuse_fork() -> None:
    if _forked:
        raise DeviceError(
            "this process was forked from one that had opened an OpenCL device, which is lost: "
            'start processes by multiprocessing.get_context("spawn"), or fork before first use'
        )


def tells_of_loss(call: Callable[Given, Result]) -> Callable[Given, Result]:
    """``call``, which raises LostDeviceError if the driver says that the device is lost.

    In a fork of the process that opened the device it raises DeviceError.
    """

    @functools.wraps(call)
    def checked(*given: Given.args, **named: Given.kwargs) -> Result:
        if _forked:
            _refuse_fork()
        try:
            return call(*given, **named)
        except cl.Error as error:
            said = str(error).strip().partition("\n")[0]
            if any(code in said for code in LOST):
                raise LostDeviceError(said) from error
            raise

    return checked


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
